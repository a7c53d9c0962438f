"""`python -m warpqem`."""

from __future__ import annotations

from warpqem.cli.main import run

if __name__ == "__main__":
    run()
