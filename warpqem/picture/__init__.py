"""Pictures without a browser: meshes in single frames, and sheets of them."""

from warpqem.picture.render import View, fit_view, render
from warpqem.picture.sheet import caption, tile, write_gif, write_png

__all__ = ["View", "caption", "fit_view", "render", "tile", "write_gif", "write_png"]
