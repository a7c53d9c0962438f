"""How many CPU threads a call is worth: starting one takes longer than the kernels of a small mesh run."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

__all__ = ["limit_threads", "thread_limit", "thread_scope", "worthwhile_threads"]

# Faces of a mesh in one pose that are worth a thread. A mesh of 320 faces took 14 ms of CPU time on one thread, 26 ms
# on 8 and 59 ms on 32; one of 20000 faces as much on 8 as on one.
FACES_PER_THREAD = 2000
# So many frames are as much work again: decimation looks at up to 16 of them.
FRAMES_PER_SHARE = 16

_limits = threading.local()


def thread_limit() -> int | None:
    """The most threads that the call at work is to use; None for all."""
    limit: int | None = getattr(_limits, "most", None)
    return limit


def limit_threads(most: int | None) -> None:
    """Set the limit of the call at work, until the :func:`thread_scope` around it ends; outside of one nothing."""
    if getattr(_limits, "depth", 0) > 0:
        _limits.most = most


@contextlib.contextmanager
def thread_scope() -> Iterator[None]:
    """A call, whose limit ends with it."""
    before = thread_limit()
    _limits.depth = getattr(_limits, "depth", 0) + 1
    try:
        yield
    finally:
        _limits.depth -= 1
        _limits.most = before


def worthwhile_threads(face_count: int, frame_count: int) -> int:
    """The most threads that simplifying a mesh is worth."""
    return max(1, int(face_count * (1.0 + frame_count / FRAMES_PER_SHARE)) // FACES_PER_THREAD)
