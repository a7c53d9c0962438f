"""Write the API reference as web pages: ``python -m docs.reference [DIR]``. It needs the extra `docs` (pdoc)."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pdoc

# What users import from; what is in other modules is an inner matter.
MODULES = (
    "warpqem",
    "warpqem.costs",
    "warpqem.errors",
    "warpqem.face",
    "warpqem.measure",
    "warpqem.picture",
    "warpqem.progressive",
    "warpqem.report",
    "warpqem.skinning",
    "warpqem.usd",
)


def main(folder: str) -> None:
    """Write the pages, ``index.html`` first."""
    for name in MODULES:
        module = importlib.import_module(name)
        # Some names are loaded when first used; pdoc looks for those that are there.
        for public in module.__all__:
            setattr(module, public, getattr(module, public))
    pdoc.render.configure(docformat="google", show_source=False, footer_text="warpqem")
    pdoc.pdoc(*MODULES, output_directory=Path(folder))
    print(Path(folder) / "index.html")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "reference")
