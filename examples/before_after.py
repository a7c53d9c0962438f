"""Simplify the galloping quadruped to 10 % and draw it before and after, with the distance as colours.

python examples/before_after.py [PICTURE.png]
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parent.parent))  # the scenes are not part of the installed package

import warpqem
from scenes import quadruped
from scenes.generate import VIEWS
from scenes.render import render, tile
from warpqem.measure import distance_colors

FRAMES = (5, 11, 18, 26)


def main(path: str) -> None:
    """Write three rows of four frames: the original, 10 % of its faces, and the distance between the two."""
    scene = quadruped.build()
    points = scene.baked()
    result = warpqem.simplify(points, scene.faces, ratio=0.1)
    colors, scale = distance_colors(points, scene.faces, result.points, result.faces)
    azimuth, elevation, middle, height = VIEWS["quadruped_gallop"]
    view = {"size": (390, 250), "azimuth": azimuth, "elevation": elevation, "frame": (np.array(middle), height)}
    rows = [
        [render(points[f], scene.faces, smooth=False, **view) for f in FRAMES],
        [render(result.points[f], result.faces, smooth=False, **view) for f in FRAMES],
        [render(result.points[f], result.faces, colors[f], **view) for f in FRAMES],
    ]
    # 128 colours keep the picture small.
    Image.fromarray(tile([p for row in rows for p in row], len(FRAMES))).quantize(128).save(path, optimize=True)
    print(f"{path}: {len(scene.faces)} -> {len(result.faces)} faces; brightest colour at {scale:.3f} % of the diagonal")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "before_after.png")
