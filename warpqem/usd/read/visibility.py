"""Poses in which a mesh is visible."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

__all__ = ["seen_frames"]


def seen_frames(prim: Usd.Prim, times: Sequence[float]) -> npt.NDArray[np.bool_]:
    """Which poses show while the mesh is visible, its own visibility and that of its ancestors taken together.

    A pose shows, blended with its neighbours, from the pose before it to the one after it, and so counts if the mesh is
    visible at any time in between, such as in the motion blur of the first frame that it can be seen in.

    Args:
        prim: The mesh.
        times: Time code of each pose, ascending.
    """
    imageable = UsdGeom.Imageable(prim)
    changes: set[float] = set()
    ancestor = prim
    while ancestor and not ancestor.IsPseudoRoot():
        attribute = UsdGeom.Imageable(ancestor).GetVisibilityAttr()
        changes.update(attribute.GetTimeSamples() if attribute else ())
        ancestor = ancestor.GetParent()
    if not changes:
        # One that never shows is to be seen by other means; all of its poses count.
        return np.ones(len(times), dtype=bool)
    # Visibility holds from one change to the next.
    moments = np.unique([*times, *changes])
    visible = np.array([imageable.ComputeVisibility(moment) != UsdGeom.Tokens.invisible for moment in moments.tolist()])
    total = np.concatenate([[0], np.cumsum(visible)])
    place = np.searchsorted(moments, times)
    first = np.append(0, place[:-1])
    # What holds from the pose before on, up to the change before the pose after.
    last = np.append(place[1:], len(moments))
    return np.asarray(total[last] > total[first], dtype=bool)
