"""Simplify the galloping quadruped to 10 % and draw it before and after, with the distance as colours.

python examples/before_after.py [PICTURE.png]
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))  # the scenes are not part of the installed package

import numpy as np

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
    # Each new vertex has the mean colour of those that it stands for.
    stands_for = np.bincount(result.vertex_map, minlength=result.points.shape[1])[:, None]
    sums = [np.bincount(result.vertex_map, channel, result.points.shape[1]) for channel in scene.colors.T]
    new_colors = np.stack(sums, axis=1) / np.maximum(stands_for, 1)
    distances, scale = distance_colors(points, scene.faces, result.points, result.faces)
    view, size = VIEWS["quadruped_gallop"], (390, 250)
    rows = [
        [render(points[f], scene.faces, view, colors=scene.colors, size=size, smooth=True) for f in FRAMES],
        [render(result.points[f], result.faces, view, colors=new_colors, size=size, smooth=True) for f in FRAMES],
        [render(result.points[f], result.faces, view, colors=distances[f], size=size, smooth=True) for f in FRAMES],
    ]
    write_png(tile([p for row in rows for p in row], len(FRAMES)), path)
    print(f"{path}: {len(scene.faces)} -> {len(result.faces)} faces; brightest colour at {scale:.3f} % of the diagonal")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "before_after.png")
