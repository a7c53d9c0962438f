"""Examples under the help of a command, which stand in its file. Tests run them on the shipped scenes."""

from __future__ import annotations

__all__ = ["epilog"]


def epilog(*examples: str) -> str:
    """What stands under the help of a command."""
    # A blank line keeps each on a line of its own.
    return "\n\n".join((f"Example{'s' if len(examples) > 1 else ''}:", *examples))
