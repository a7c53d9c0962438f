"""Linear blend skins and blend shapes of simplified meshes."""

from warpqem.skinning.fit_skin import FittedSkin, fit_skin
from warpqem.skinning.linear_skin import LinearSkin
from warpqem.skinning.reduce_joints import ReducedJoints, reduce_joints
from warpqem.skinning.reduce_shapes import ReducedShapes, reduce_shapes

__all__ = [
    "FittedSkin",
    "LinearSkin",
    "ReducedJoints",
    "ReducedShapes",
    "fit_skin",
    "reduce_joints",
    "reduce_shapes",
]
