"""Fixtures shared by all tests."""

import os
import signal

import hypothesis
import pytest
import warp as wp

# What the caller ignores, as `nohup` and background jobs of a shell do, every command that a test starts would ignore.
for _name in ("SIGHUP", "SIGQUIT", "SIGINT"):
    _number = getattr(signal, _name, None)
    if _number is not None and signal.getsignal(_number) == signal.SIG_IGN:
        signal.signal(_number, signal.default_int_handler if _name == "SIGINT" else signal.SIG_DFL)

# The ways of a GPU on the CPU: before any kernel is compiled.
if "CUDA_SEMANTICS" in os.environ:
    from tests.support import cuda_semantics

    cuda_semantics.install(os.environ["CUDA_SEMANTICS"])

# Where a run decides about a change, it tries the same examples every time; elsewhere new ones on every run. No test is
# about time: a machine may be busy.
hypothesis.settings.register_profile("ci", derandomize=True, deadline=None)
hypothesis.settings.register_profile("new examples", deadline=None)
hypothesis.settings.load_profile("ci" if os.environ.get("CI") else "new examples")


# Files that take longest begin first, so that no process is left with one of them at the end.
LONG = (
    "project/test_examples.py",
    "project/test_docs.py",
    "kernels/test_compile.py",
    "project/test_scenes.py",
    "batching/test_batch_local.py",
    "cli/test_cli_comfort.py",
    "project/test_device_benchmark.py",
)


def pytest_configure(config):
    # Files are begun in their order, and not by the number of their tests.
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: not item.nodeid.split("::")[0].endswith(LONG))


@pytest.fixture(scope="session", params=["cpu", "cuda:0"] if wp.is_cuda_available() else ["cpu"])
def device(request):
    """Every Warp device to test on: the CPU, and the first GPU where there is one."""
    return request.param


@pytest.fixture(params=[False, True], ids=["layer", "flat"])
def flatten(request):
    """Both output forms: a layer over the input, and one flattened file."""
    return request.param
