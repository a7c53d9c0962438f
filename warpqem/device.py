"""Choice of the Warp device."""

from __future__ import annotations

import warp as wp

from warpqem.errors import DeviceError

__all__ = ["resolve_device"]


def resolve_device(device: str | None = None) -> str:
    """Name of the Warp device to run on.

    Args:
        device: Warp device name such as ``"cpu"``, ``"cuda"`` or ``"cuda:1"``; None takes ``"cuda:0"`` where there is a
            CUDA device and ``"cpu"`` elsewhere.

    Raises:
        DeviceError: this machine has no such device; the message names the devices that exist.
    """
    if device is None:
        return "cuda:0" if wp.is_cuda_available() else "cpu"
    try:
        return wp.get_device(device).alias
    except (ValueError, RuntimeError, TypeError) as error:
        existing = ", ".join(d.alias for d in wp.get_devices())
        raise DeviceError(f"no Warp device {device!r} on this machine; it has: {existing}") from error
