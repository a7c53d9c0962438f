"""What Warp says while it starts and loads kernels: nothing, unless the caller has asked for it.

A caller has who has set Warp's log level or its logger, such as the command line.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator

import warp as wp

__all__ = ["quiet_loading", "quiet_start"]

# Warp's library prints this itself on a machine without a GPU, past all loggers.
NO_DRIVER = b"Could not find or load the NVIDIA CUDA driver"


@contextlib.contextmanager
def quiet_loading() -> Iterator[None]:
    """Keep Warp from a line for each module within, where nobody has asked for them."""
    asked = wp.config.log_level != wp.LOG_INFO or type(wp.get_logger()).__module__.partition(".")[0] != "warp"
    if asked:
        yield
        return
    wp.config.log_level = wp.LOG_WARNING
    try:
        yield
    finally:
        wp.config.log_level = wp.LOG_INFO


@contextlib.contextmanager
def quiet_start() -> Iterator[None]:
    """Keep Warp from saying within which devices there are, or that there is no GPU."""
    with quiet_loading(), _without_driver_line():
        yield


@contextlib.contextmanager
def _without_driver_line() -> Iterator[None]:
    """Hold back what goes to stderr within, and write it afterwards but for the line about the driver."""
    try:
        stderr = os.dup(2)
    except OSError:  # a process without stderr
        yield
        return
    try:
        with tempfile.TemporaryFile() as held:
            if sys.stderr is not None:
                sys.stderr.flush()
            os.dup2(held.fileno(), 2)
            try:
                yield
            finally:
                os.dup2(stderr, 2)
                held.seek(0)
                for line in held:
                    if NO_DRIVER not in line:
                        os.write(2, line)
    finally:
        os.close(stderr)
