"""What a command loads, without Python's search for garbage.

While modules are loaded Python looks through all objects there are, again and again, for garbage that is not there.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

from warpqem.cli.console import load_usd, quiet_libraries

__all__ = ["loading", "own_process"]

# Whether nothing else is done in this process: objects of others may become garbage.
_is_own_process = False


def own_process() -> None:
    """Note that this process does one command, and ends."""
    global _is_own_process
    _is_own_process = True


@contextmanager
def loading(*, usd: bool = True) -> Iterator[None]:
    """Load Warp, and USD unless told otherwise, and what is imported within: garbage is not searched for meanwhile.

    Nor is it later, in a command's own process, among what has been loaded.

    Raises:
        UsdLibraryError: USD is missing, broken or too old.
    """
    searches = gc.isenabled()
    gc.disable()
    try:
        quiet_libraries()
        if usd:
            load_usd()
        yield
    finally:
        if _is_own_process:
            gc.freeze()
        if searches:
            gc.enable()
