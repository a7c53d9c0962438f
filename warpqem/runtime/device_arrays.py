"""Arrays of callers that are on a device: Warp arrays over their memory, in the order of streams."""

from __future__ import annotations

from typing import Any

import warp as wp

from warpqem.runtime.device import array_device

__all__ = ["warp_array"]

# Handles of streams in the CUDA array interface: the legacy default stream.
LEGACY_STREAM = 1


def warp_array(value: Any) -> wp.array | None:
    """A Warp array over the memory of an array on a device, see :func:`array_device`; None for other arguments.

    What is queued on its device's current Warp stream from now on comes after what its producer has queued: DLPack does
    that, and the ``stream`` entry of the CUDA array interface is waited for by an event. The Warp array holds a
    reference.

    Raises:
        Exception: what the array raises, or ValueError for a stream that there is not.
    """
    device = array_device(value)
    if device is None:
        return None
    if isinstance(value, wp.array):
        return value
    if isinstance(value, wp.indexedarray):
        return value.contiguous()
    if hasattr(type(value), "__dlpack__"):
        return wp.from_dlpack(value)
    _wait_for(value.__cuda_array_interface__.get("stream"), device)
    return wp.array(value, device=device, copy=False)


def _wait_for(handle: int | None, device: str) -> None:
    """Let the device's current Warp stream wait for what is queued on another one; None for nothing to wait for."""
    if handle is None:
        return
    if handle < LEGACY_STREAM:
        raise ValueError(f"stream {handle} in __cuda_array_interface__: expected None or a number above 0")
    there = wp.get_device(device)
    stream = there.null_stream if handle == LEGACY_STREAM else wp.Stream(there, cuda_stream=handle)
    wp.get_stream(there).wait_stream(stream)
