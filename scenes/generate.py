"""Write all scenes: ``python -m scenes.generate [--out DIR] [--picture PNG]``."""

import argparse
from collections.abc import Callable
from pathlib import Path

from scenes import cape, head, quadruped
from scenes.scene import Scene
from scenes.stage import write
from warpqem.picture import View, render, tile, write_png

SCENES: dict[str, Callable[[], Scene]] = {
    "quadruped_gallop": quadruped.build,
    "cape_wind": cape.build,
    "talking_head": head.build,
}
# Camera of each scene in the picture.
VIEWS = {
    "quadruped_gallop": View(66.0, 6.0, (0.0, 1.06, 0.02), 2.45),
    "cape_wind": View(125.0, 16.0, (0.0, 1.12, -0.55), 1.55),
    "talking_head": View(16.0, 2.0, (0.0, -2.3, 1.0), 29.5),
}
# Frames shown of each scene, out of its loop.
PICTURED = (0.04, 0.14, 0.25, 0.41)


def picture(scenes: dict[str, Scene], path: str | Path) -> None:
    """Write a PNG with a row of four frames per scene."""
    pictures = []
    for name, scene in scenes.items():
        baked = scene.baked()
        for share in PICTURED:
            points = baked[int(share * scene.frame_count)]
            options = {"colors": scene.colors, "size": (320, 260), "smooth": True}
            pictures.append(render(points, scene.faces, VIEWS[name], **options))
    write_png(tile(pictures, len(PICTURED)), path)


def main() -> None:
    """Parse the command line and write the scenes."""
    parser = argparse.ArgumentParser(prog="python -m scenes.generate", description="Write the animated test scenes.")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, help="folder for the USD files")
    parser.add_argument("--picture", type=Path, help="also write a contact sheet of the scenes to this PNG")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    scenes = {name: build() for name, build in SCENES.items()}
    for name, scene in scenes.items():
        path = arguments.out / f"{name}.usdc"
        write(scene, path)
        size = path.stat().st_size / 1e6
        print(
            f"{path}: {len(scene.faces)} faces, {len(scene.points)} vertices, {scene.frame_count} frames, {size:.2f} MB"
        )
    if arguments.picture:
        picture(scenes, arguments.picture)


if __name__ == "__main__":
    main()
