"""Simplify the meshes of the open scene of Blender, rigs and shape keys included, by way of USD and back.

In Blender's text editor: set WARPQEM below, open this file and run it. On a command line:

    blender character.blend --background --python blender_simplify.py -- simple.blend --ratio 0.25

Armatures, actions, materials and modifiers stay; meshes get fewer faces. Undo (Ctrl-Z) brings the old ones back.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from types import ModuleType

import bpy

# The program, such as "/home/me/warpqem/.venv/bin/warpqem"; by default the one on the path.
WARPQEM = os.environ.get("WARPQEM") or shutil.which("warpqem") or "warpqem"
# Options of `warpqem simplify`.
OPTIONS = ["--ratio", "0.25"]


def warpqem_script() -> ModuleType:
    """The module of warpqem for Blender, which needs nothing beside it."""
    python = Path(WARPQEM).with_name("python")
    code = "import warpqem, pathlib; print(pathlib.Path(warpqem.__file__).parent)"
    found = subprocess.run([python, "-c", code], capture_output=True, text=True, check=True, env=clean_environment())
    path = Path(found.stdout.strip(), "gltf", "blender_script.py")
    spec = importlib.util.spec_from_file_location("warpqem_blender_script", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def clean_environment() -> dict[str, str]:
    """The environment without what makes another Python load Blender's modules."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONHOME"}


def simplify_scene(options: list[str]) -> list[str]:
    """Simplify all meshes of the scene; the objects whose mesh is another one now."""
    script = warpqem_script()
    with tempfile.TemporaryDirectory() as folder:
        scene, simplified = (os.path.join(folder, name) for name in ("scene.usdc", "simplified.usdc"))
        names = script.write_stage(scene)
        command = [WARPQEM, "simplify", scene, "-o", simplified, "--flatten", *options]
        subprocess.run(command, check=True, env=clean_environment())
        return script.take_meshes(simplified, names)


def main() -> None:
    """Simplify the scene, and save it where a file is named."""
    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    output = given.pop(0) if given and not given[0].startswith("-") else None
    for name in simplify_scene(given or OPTIONS):
        print(f"{name}: {len(bpy.data.objects[name].data.polygons)} faces")
    if output is not None:
        bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath(output))


if __name__ == "__main__":
    main()
