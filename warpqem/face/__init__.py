"""Faces: named feature points, levels that keep them, and expressions carried to other faces.

After "multiresolution facial animation" (here: the face paper), whose points and retargeting are those of expression
cloning (Noh & Neumann 2001).
"""

from warpqem.face.feature_names import FEATURE_NAMES, MIDLINE, PAIRS
from warpqem.face.feature_points import FacialFeatures, facial_features
from warpqem.face.protect import FaceProtection, face_sums
from warpqem.face.retarget import FaceMesh, RetargetedMotion, retarget

__all__ = [
    "FEATURE_NAMES",
    "MIDLINE",
    "PAIRS",
    "FaceMesh",
    "FaceProtection",
    "FacialFeatures",
    "RetargetedMotion",
    "face_sums",
    "facial_features",
    "retarget",
]
