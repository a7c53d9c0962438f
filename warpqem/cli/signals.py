"""The signals that end a command, held back until there are handlers for them. Loads next to nothing."""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType

__all__ = ["STOP_SIGNALS", "handle_signals", "hold_signals", "ignore_signals"]

# Ctrl-C, schedulers, a terminal that is closed, and Ctrl-\.
STOP_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)
)

_mask: set[int] = set()


def hold_signals() -> None:
    """Let signals wait until `handle_signals` is called, in this process and in those it forks."""
    global _mask
    if hasattr(signal, "pthread_sigmask"):
        _mask = set(signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS))


def handle_signals(handler: Callable[[int, FrameType | None], None]) -> None:
    """Handle signals, except those that the parent process had ignored, as `nohup` does."""
    for number in STOP_SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)
    signal.pthread_sigmask(signal.SIG_SETMASK, _mask)


def ignore_signals() -> None:
    """From now on nothing ends this process early, which is at its end."""
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
