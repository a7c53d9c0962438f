"""Host work that a thread does ahead, while the one that feeds a device goes on."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

__all__ = ["done_ahead"]

Found = TypeVar("Found")


def done_ahead(work: Callable[[], Found]) -> Callable[[], Found]:
    """What gives the result of ``work``, which a thread has begun with; an exception comes where the result is asked
    for.
    """
    pool = ThreadPoolExecutor(1, thread_name_prefix="warpqem-ahead")
    found = pool.submit(work)
    # The thread ends with its work.
    pool.shutdown(wait=False)
    return found.result
