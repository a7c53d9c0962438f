"""What warpqem needs beside USD, one requirement a line: for a Python that has a USD of its own.

python -m warpqem.requirements > requirements.txt

Runs where warpqem is installed without its dependencies, so it imports none of them.
"""

from __future__ import annotations

import re
from importlib.metadata import requires

__all__ = ["requirements_beside_usd"]


def requirements_beside_usd() -> list[str]:
    """The requirements of the installed warpqem without usd-core and without those of extras.

    Raises:
        importlib.metadata.PackageNotFoundError: warpqem is on the path but not installed.
    """
    own = [line for line in requires("warpqem") or () if not re.search(r"\bextra\s*==", line)]
    return [line for line in own if re.split(r"[\s;<>=!~\[(]", line, maxsplit=1)[0] != "usd-core"]


if __name__ == "__main__":
    print("\n".join(requirements_beside_usd()))
