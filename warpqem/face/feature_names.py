"""The 32 feature points of a face by name.

Left and right are the person's: with +y up and +z out of the face, left is +x. The face paper calls +x the right side,
that of a picture from the front: its right is our left.

| on the midline | where |
|---|---|
| head_top | the highest point of the head |
| nose_top | the root of the nose, deepest between forehead and nose |
| nose_tip | the foremost point of the nose |
| nose_bottom | the corner between nose and upper lip |
| upper_lip, lower_lip | the foremost points of the lips |
| lip_contact | where the lips meet |
| lip_bottom | the crease between lower lip and chin |
| chin | the foremost point of the chin |
| throat | the corner between chin and neck |

| of both sides | where |
|---|---|
| head_side | the widest point of the head: the rim of the ear where there are ears |
| nose_side | the groove beside the wing of the nose |
| eye_inner, eye_outer | the corners of the eye |
| eye_socket | deepest between eye and brow |
| brow_inner, brow_outer | the edge of the brow above the corners of the eye |
| cheek | the cheek bone, foremost in three-quarter view |
| mouth_corner | the end of the line where the lips meet |
| upper_lip, lower_lip | on the lip, half way to the corner |
"""

from __future__ import annotations

__all__ = ["FEATURE_NAMES", "MIDLINE", "PAIRS", "SIDES"]

MIDLINE = (
    "head_top",
    "nose_top",
    "nose_tip",
    "nose_bottom",
    "upper_lip",
    "lip_contact",
    "lower_lip",
    "lip_bottom",
    "chin",
    "throat",
)
PAIRS = (
    "head_side",
    "nose_side",
    "eye_inner",
    "eye_outer",
    "eye_socket",
    "brow_inner",
    "brow_outer",
    "cheek",
    "mouth_corner",
    "upper_lip",
    "lower_lip",
)
SIDES = ("left", "right")
FEATURE_NAMES = (*MIDLINE, *(f"{pair}_{side}" for pair in PAIRS for side in SIDES))
