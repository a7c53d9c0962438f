"""Simplify the galloping quadruped to 10 % and draw it before and after, with the distance as colours.

python examples/before_after.py [PICTURE.png]
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))  # the scenes are not part of the installed package

import warpqem
from scenes import quadruped
from scenes.generate import VIEWS
from warpqem.measure import distance_colors
from warpqem.picture import render, tile, write_png

FRAMES = (5, 11, 18, 26)


def main(path: str) -> None:
    """Write three rows of four frames: the original, 10 % of its faces, and the distance between the two."""
    scene = quadruped.build()
    points = scene.baked()
    result = warpqem.simplify(points, scene.faces, ratio=0.1)
    colors, scale = distance_colors(points, scene.faces, result.points, result.faces)
    view, size = VIEWS["quadruped_gallop"], (390, 250)
    rows = [
        [render(points[f], scene.faces, view, size=size) for f in FRAMES],
        [render(result.points[f], result.faces, view, size=size) for f in FRAMES],
        [render(result.points[f], result.faces, view, colors=colors[f], size=size, smooth=True) for f in FRAMES],
    ]
    # 128 colours keep the picture small.
    write_png(tile([p for row in rows for p in row], len(FRAMES)), path, colors=128)
    print(f"{path}: {len(scene.faces)} -> {len(result.faces)} faces; brightest colour at {scale:.3f} % of the diagonal")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "before_after.png")
