"""`python -m warpqem`."""

from __future__ import annotations

from warpqem.cli.main import app

if __name__ == "__main__":
    app(prog_name="warpqem")
