"""Linear blend skins of simplified meshes."""

from warpqem.skinning.fit_skin import FittedSkin, fit_skin
from warpqem.skinning.linear_skin import LinearSkin

__all__ = ["FittedSkin", "LinearSkin", "fit_skin"]
