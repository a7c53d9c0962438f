"""Blender in a process of its own: which program it is, and what it says where it fails."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from warpqem.errors import MeshFileError, OptionError

__all__ = ["BLENDER_VARIABLE", "blender_command", "run_blender"]

# Names a Blender, or a Python that has its module.
BLENDER_VARIABLE = "WARPQEM_BLENDER"
SCRIPT = Path(__file__).with_name("blender_script.py")


def blender_command() -> list[str]:
    """The command line that runs the script, but for its arguments.

    Raises:
        OptionError: there is no Blender; the message names the extra.
    """
    named = os.environ.get(BLENDER_VARIABLE)
    if named is None:
        if importlib.util.find_spec("bpy") is None:
            raise OptionError(
                "animated glTF files need Blender: pip install 'warpqem[gltf]' for its module, which has wheels for "
                f"Python 3.11 and 3.13, or set {BLENDER_VARIABLE} to a Blender or to a Python that has the module"
            )
        return [sys.executable, "-P", os.fspath(SCRIPT)]
    program = shutil.which(named)
    if program is None:
        raise OptionError(f"{BLENDER_VARIABLE} is {named!r}, and there is no such program")
    if "python" in Path(program).name.lower():
        return [program, "-P", os.fspath(SCRIPT)]
    options = ["--background", "--factory-startup", "--python-exit-code", "1", "--python"]
    return [program, *options, os.fspath(SCRIPT), "--"]


def run_blender(command: Sequence[str], arguments: Sequence[str], what: str) -> None:
    """Run the script to its end.

    Args:
        command: See `blender_command`.
        arguments: Those of the script.
        what: What fails where it does, for the message.

    Raises:
        MeshFileError: it fails; the message has the last line that it said.
    """
    # What Blender loads of its own must not be that of this process.
    environment = {name: value for name, value in os.environ.items() if name != "PXR_PLUGINPATH_NAME"}
    done = subprocess.run(
        [*command, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=environment,
        check=False,
    )
    if done.returncode == 0:
        return
    lines = [line.strip() for line in done.stdout.decode("utf-8", "replace").splitlines() if line.strip()]
    # What Blender says while it ends comes after the error.
    errors = [line for line in lines if "Error" in line] or lines or [f"exit code {done.returncode}"]
    raise MeshFileError(f"{what}: Blender fails ({errors[-1]})")
