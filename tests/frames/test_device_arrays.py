"""Arrays of other libraries on a device: where they are, when they are ready, and how they are refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import warp as wp

import warpqem
from tests.support.device_arrays import FACES, OPTIONS, POINTS, assert_same, on
from warpqem.errors import MeshShapeError
from warpqem.runtime import device as devices


class CudaArray:
    """An array with the CUDA array interface and nothing else, as Numba's are."""

    def __init__(self, array: wp.array, stream: int | None) -> None:
        self.array, self.stream = array, stream

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        return {**self.array.__cuda_array_interface__, "version": 3, "stream": self.stream}


needs_gpu = pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")


@needs_gpu
@pytest.mark.parametrize("make", ["warp", "torch", "cupy", "interface"])
def test_arrays_on_a_gpu_come_after_what_their_stream_does_and_stay_there(make):
    """The points are written late on a stream of their own, which nobody waits for before the call."""
    expected = warpqem.simplify(POINTS, FACES, device="cuda:0", **OPTIONS)
    if make == "torch":
        torch = pytest.importorskip("torch")
        stream = torch.cuda.Stream()
        source = torch.from_numpy(POINTS).cuda()
        torch.cuda.synchronize()
        with torch.cuda.stream(stream):
            torch.cuda._sleep(10**8)
            found = warpqem.simplify(source * 1, torch.from_numpy(FACES).cuda(), **OPTIONS)
        back = torch.from_dlpack(found.points)
        assert back.device.index == 0
        np.testing.assert_array_equal(back.cpu().numpy(), expected.points)
    elif make == "cupy":
        cupy = pytest.importorskip("cupy")
        source = cupy.asarray(POINTS)
        cupy.cuda.Device().synchronize()
        with cupy.cuda.Stream(non_blocking=True):
            for _ in range(200):
                source = source + 1 - 1
            points = source * 0 + cupy.asarray(POINTS)
            found = warpqem.simplify(points, cupy.asarray(FACES), **OPTIONS)
        np.testing.assert_array_equal(cupy.asarray(found.points).get(), expected.points)
    elif make == "warp":
        found = warpqem.simplify(*on("cuda:0"), **OPTIONS)
    else:
        stream = wp.Stream("cuda:0")
        target, source = wp.zeros(POINTS.shape, device="cuda:0"), wp.array(POINTS, device="cuda:0")
        wp.synchronize_device("cuda:0")
        wp.copy(target, source, stream=stream)
        found = warpqem.simplify(CudaArray(target, stream.cuda_stream), FACES, **OPTIONS)
    assert_same(found, expected)
    assert found.points.device.alias == "cuda:0"


@needs_gpu
def test_array_on_a_gpu_is_simplified_on_the_host_where_that_is_asked_for():
    found = warpqem.simplify(*on("cuda:0"), device="cpu", **OPTIONS)
    assert isinstance(found.points, np.ndarray)
    assert_same(found, warpqem.simplify(POINTS, FACES, device="cpu", **OPTIONS))


@needs_gpu
def test_stream_that_there_is_none_of_is_refused():
    with pytest.raises(MeshShapeError, match=r"points cannot be converted .* stream 0 in __cuda_array_interface__"):
        warpqem.simplify(CudaArray(wp.array(POINTS, device="cuda:0"), 0), FACES, **OPTIONS)


class FakeTensor:
    """A tensor that says by DLPack which device it is on."""

    def __init__(self, kind: int) -> None:
        self.kind = kind

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.kind, 0

    def __dlpack__(self, **options: Any) -> Any:
        raise BufferError("tensor requires grad")


def test_device_of_an_array_is_that_which_it_says(monkeypatch):
    monkeypatch.setattr(devices, "resolve_device", lambda name: name)
    monkeypatch.setattr(devices, "device_traits", lambda name: replace(devices.GPU, own_memory=name != "cpu"))
    assert [devices.array_device(FakeTensor(kind)) for kind in (1, 2, 3, 13)] == [None, "cuda:0", None, "cuda:0"]
    assert devices.array_device(POINTS) is None
    assert devices.array_device(wp.array(POINTS, device="cpu")) is None


def test_tensor_that_does_not_say_where_it_is_is_named_when_it_is_read():
    class Lost(FakeTensor):
        def __dlpack_device__(self) -> tuple[int, int]:
            raise BufferError("no such device")

    with pytest.raises(MeshShapeError, match=r"points cannot be converted to an array \(Lost: BufferError"):
        warpqem.simplify(Lost(1), FACES, **OPTIONS)
