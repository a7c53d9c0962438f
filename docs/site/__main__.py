"""Write the documentation as a site: ``python -m docs.site [DIR]``, from a checkout. It needs the extra `docs`."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def main(folder: str | None) -> int:
    """Build the site; a warning is an error."""
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet"]
    if folder is not None:
        command += ["--site-dir", str(Path(folder).resolve())]
    # The theme otherwise prints an announcement of its makers.
    code = subprocess.run(command, cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, check=False).returncode
    if code == 0:
        print(Path(folder or ROOT / "build" / "site") / "index.html")
    return code


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m docs.site", description="Write the documentation as a site.")
    parser.add_argument("folder", nargs="?", help="where to; build/site by default")
    sys.exit(main(parser.parse_args().folder))
