"""SciPy, which only faces need."""

from __future__ import annotations

import importlib.util

from warpqem.errors import OptionError

__all__ = ["need_scipy"]


def need_scipy() -> None:
    """Say how to get SciPy where it is not there.

    Raises:
        OptionError: it is not installed.
    """
    if importlib.util.find_spec("scipy") is None:
        raise OptionError("faces need SciPy: pip install 'warpqem[face]'")
