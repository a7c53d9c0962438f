"""The same work with usd-core and with another package's `pxr`, installed as docs/install.md says: the same values.

python -m tests.long.other_usd
python -m tests.long.other_usd "usd-exchange==2.3.0" --scenes quadruped_gallop
python -m tests.long.other_usd --python hython

Makes an environment of its own, or takes an interpreter that has warpqem and a USD. The one that runs this has
usd-core. Prints what was compared.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

from pxr import Usd

ROOT = Path(__file__).resolve().parents[2]
# The package that the commands of the page install.
EXAMPLE = "usd-exchange"


def documented_commands(package: str) -> list[str]:
    """The commands of docs/install.md, with the package in place of the one that they name."""
    page = (ROOT / "docs" / "install.md").read_text("utf-8")
    [block] = re.findall(r"^```sh\n(.*?)^```", page, re.S | re.M)
    return [line.replace(EXAMPLE, f"'{package}'") for line in block.splitlines()]


def make_environment(folder: Path, package: str) -> Path:
    """An environment with the package and warpqem; returns its interpreter."""
    venv.create(folder, with_pip=True)
    programs = folder / ("Scripts" if os.name == "nt" else "bin")
    environment = {**without_path(), "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    for command in documented_commands(package):
        # The requirements are written beside the environment, not into the checkout.
        command = command.replace("requirements.txt", f"'{folder}/requirements.txt'")
        subprocess.run(command, shell=True, check=True, cwd=ROOT, env=environment)
    return programs / "python"


def without_path() -> dict[str, str]:
    """The environment for an interpreter that is to see what is installed for it and nothing else."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


def simplify(python: str | Path, scene: Path, output: Path, environment: dict[str, str]) -> None:
    command = [str(python), "-m", "warpqem", "simplify", str(scene), "-o", str(output), "--ratio", "0.1"]
    # Outside of the checkout, so that each interpreter takes the warpqem that is installed for it.
    subprocess.run(
        [*command, "--device", "cpu", "--flatten"],
        check=True,
        cwd=output.parent,
        stdout=subprocess.DEVNULL,
        env=environment,
    )


def usd_version(python: str | Path) -> str:
    code = "from pxr import Usd; print('.'.join(map(str, Usd.GetVersion()[1:])))"
    return subprocess.run([str(python), "-c", code], check=True, capture_output=True, text=True).stdout.strip()


def values_of(path: Path) -> dict[str, object]:
    """Every authored value of a file, by attribute and time."""
    found: dict[str, object] = {}
    stage = Usd.Stage.Open(str(path))
    for prim in stage.TraverseAll():
        for attribute in prim.GetAuthoredAttributes():
            for time in (Usd.TimeCode.Default(), *map(Usd.TimeCode, attribute.GetTimeSamples())):
                found[f"{attribute.GetPath()} at {time}"] = attribute.Get(time)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", nargs="?", default=EXAMPLE)
    parser.add_argument("--python", help="an interpreter that has warpqem and a USD, instead of a package")
    parser.add_argument("--scenes", nargs="+", default=sorted(path.stem for path in (ROOT / "scenes").glob("*.usdc")))
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="warpqem-usd-") as name:
        folder = Path(name)
        other = arguments.python or make_environment(folder / "environment", arguments.package)
        print(f"USD {usd_version(sys.executable)} here, {usd_version(other)} there ({other})", flush=True)
        # An application's interpreter may find warpqem by that path.
        apart = {**os.environ} if arguments.python else without_path()
        differences = 0
        for scene in arguments.scenes:
            values = []
            for python, kind, environment in ((sys.executable, "here", {**os.environ}), (other, "there", apart)):
                output = folder / f"{scene}_{kind}.usdc"
                simplify(python, ROOT / "scenes" / f"{scene}.usdc", output, environment)
                values.append(values_of(output))
            here, there = values
            wrong = [key for key in here.keys() | there.keys() if key not in here or key not in there]
            wrong += [key for key in here.keys() & there.keys() if here[key] != there[key]]
            print(f"{scene}: {len(here)} values, {len(wrong)} differ", *sorted(wrong)[:10], sep="\n  ", flush=True)
            differences += len(wrong)
    sys.exit(1 if differences else 0)


if __name__ == "__main__":
    main()
