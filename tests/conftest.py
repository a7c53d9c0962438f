"""Fixtures shared by all tests."""

import os

import hypothesis
import pytest
import warp as wp

# The ways of a GPU on the CPU: before any kernel is compiled.
if "CUDA_SEMANTICS" in os.environ:
    from tests import cuda_semantics

    cuda_semantics.install(os.environ["CUDA_SEMANTICS"])

# Where a run decides about a change, it tries the same examples every time; elsewhere new ones on every run.
hypothesis.settings.register_profile("ci", derandomize=True)
if os.environ.get("CI"):
    hypothesis.settings.load_profile("ci")


@pytest.fixture(scope="session", params=["cpu", "cuda:0"] if wp.is_cuda_available() else ["cpu"])
def device(request):
    """Every Warp device to test on: the CPU, and the first GPU where there is one."""
    return request.param


@pytest.fixture(params=[False, True], ids=["layer", "flat"])
def flatten(request):
    """Both output forms: a layer over the input, and one flattened file."""
    return request.param
