"""Pictures without a browser: meshes in single frames, sheets of them, and how alike those of two meshes are."""

from warpqem.picture.images import ImagePair, ImageScore, PosedMesh, compare_images
from warpqem.picture.render import View, fit_view, render
from warpqem.picture.sheet import caption, tile, write_gif, write_png

__all__ = [
    "ImagePair",
    "ImageScore",
    "PosedMesh",
    "View",
    "caption",
    "compare_images",
    "fit_view",
    "render",
    "tile",
    "write_gif",
    "write_png",
]
