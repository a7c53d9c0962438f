"""Trials that take minutes, run by hand: `python -m tests.long.kills`, `.many`, `.fuzz`, `.other_usd`.

Each prints its counts."""

import sys
from pathlib import Path

# The stages that the tests make are used here too.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
