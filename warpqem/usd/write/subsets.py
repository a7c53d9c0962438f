"""Transfer face subsets of a mesh to its new faces."""

from __future__ import annotations

import numpy as np
from pxr import Sdf, UsdGeom, Vt

from warpqem.usd.read.descendants import subsets_of
from warpqem.usd.read.value_arrays import blocked_codes, sample_codes
from warpqem.usd.write.attribute_transfer import AttributeTransfer
from warpqem.usd.write.remove_properties import Dropped

__all__ = ["transfer_subsets"]


def transfer_subsets(mesh: UsdGeom.Mesh, transfer: AttributeTransfer, dropped: Dropped) -> None:
    """Give every face subset the new faces that go on from its faces; subsets of points or edges are deactivated.

    Each new face goes on from one authored face, so subsets that do not overlap, or that share out all faces, still do.
    USD takes a family without any face for damaged, so the subsets of one that loses its last face are deactivated.
    Those without a family stay.
    """
    lost, emptied = 0, []
    families: dict[str, list[UsdGeom.Subset]] = {}
    # Whether the subsets of a family had any face, and have one.
    faces_of: dict[str, tuple[bool, bool]] = {}
    for subset in subsets_of(mesh):
        if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
            if transfer.names_feature_point(subset):
                continue
            subset.GetPrim().SetActive(False)
            dropped.deactivated.append(subset.GetPath())
            lost += 1
            continue
        attribute = subset.GetIndicesAttr()
        members = {code: np.asarray(attribute.Get(code), dtype=np.int64) for code in sample_codes(attribute)}
        blocked = blocked_codes(attribute)
        left = 0
        for code, polygons in members.items():
            faces = np.flatnonzero(np.isin(transfer.face_polygon, polygons)).astype(np.int32)
            attribute.Set(Vt.IntArray.FromNumpy(faces), code)
            left += len(faces)
        if not left and any(map(len, members.values())):
            emptied.append(subset.GetPrim().GetName())
        for code in blocked:
            attribute.Set(Sdf.ValueBlock(), code)
        family = subset.GetFamilyNameAttr().Get()
        if family:
            families.setdefault(family, []).append(subset)
            had, has = faces_of.get(family, (False, False))
            faces_of[family] = had or any(map(len, members.values())), has or left > 0
    for family, subsets in families.items():
        if faces_of[family] == (True, False):
            for subset in subsets:
                subset.GetPrim().SetActive(False)
                dropped.deactivated.append(subset.GetPath())
    if emptied:
        dropped.names.append(f"all faces of GeomSubset{'s' if len(emptied) > 1 else ''} {', '.join(emptied)}")
    if lost:
        dropped.names.append(f"{lost} GeomSubset{'s' if lost > 1 else ''} of points or edges")
