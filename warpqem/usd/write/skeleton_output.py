"""Skeletons and their animations without the joints that no mesh uses any more.

A joint that stays gets the transforms of the joints between it and the next one above that stays, composed. Where that
is no translation, rotation and scale, as with a turn between uneven scales, the joint above stays as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from warpqem.usd.read.hidden_users import hidden_properties
from warpqem.usd.read.skin_poses import first_repeated

__all__ = ["reduce_skeletons"]

# Parts of a transform may differ so much when it is made of translation, rotation and scale again: scales are halves.
TOLERANCE = 1e-3

# Determinant of the axes of a transform, below which it has no scale along one of them and cannot be taken apart.
MIN_VOLUME = 1e-12
# Properties of a prim that is skinned.
SKIN_PROPERTIES = frozenset({"primvars:skel:jointIndices", "skel:joints", "skel:skeleton"})

Matrices = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Bound:
    """A skeleton and the prims that it moves.

    Attributes:
        query: the skeleton.
        targets: what it moves.
    """

    query: UsdSkel.SkeletonQuery
    targets: list[UsdSkel.SkinningQuery]

    @property
    def prim(self) -> Usd.Prim:
        return self.query.GetPrim()

    @property
    def names(self) -> list[str]:
        return list(self.query.GetJointOrder())


def reduce_skeletons(stage: Usd.Stage) -> list[str]:
    """Take the joints that move nothing off the skeletons of a stage and off their animations.

    Args:
        stage: the stage, whose edit target takes the edits.

    Returns:
        What was done and what was left, a line for each skeleton.
    """
    # The queries of the cache have the values from before, which is what they are asked for.
    cache = UsdSkel.Cache()
    bound: dict[Sdf.Path, _Bound] = {}
    # Meshes of instances are moved, too.
    everywhere = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
    for prim in stage.Traverse(everywhere):
        if prim.IsA(UsdSkel.Root):
            root = UsdSkel.Root(prim)
            cache.Populate(root, everywhere)
            for binding in cache.ComputeSkelBindings(root, everywhere):
                query = cache.GetSkelQuery(binding.GetSkeleton())
                if query and binding.GetSkinningTargets():
                    found = bound.setdefault(query.GetPrim().GetPath(), _Bound(query, []))
                    found.targets.extend(binding.GetSkinningTargets())
    animations = [_animation(each) for each in bound.values()]
    hidden = _hidden_skin(stage) if bound else None
    lines = []
    for _, each in sorted(bound.items()):
        animation = _animation(each)
        shared = animation is not None and animations.count(animation) > 1
        line = _why_not(each, animation, shared)
        if line is None and hidden is not None:
            line = f"a variant that is not selected has a skin: {hidden}"
        lines.append(_reduce(each, animation) if line is None else f"{each.prim.GetPath()}: all joints stay, as {line}")
    return [line for line in lines if line]


def _animation(bound: _Bound) -> Usd.Prim | None:
    query = bound.query.GetAnimQuery()
    return query.GetPrim() if query else None


def _why_not(bound: _Bound, animation: Usd.Prim | None, shared: bool) -> str | None:
    if shared:
        return "another skeleton has the same animation"
    orders = {bound.prim: bound.names, **{target.GetPrim(): target.GetJointOrder() for target in bound.targets}}
    for prim, order in orders.items():
        repeated = first_repeated(order or ())
        if repeated is not None:
            return f"{prim.GetPath()} names the joint {repeated} twice"
    if animation is not None and not animation.IsA(UsdSkel.Animation):
        return f"{animation.GetPath()} is no SkelAnimation"
    edited = [bound.prim, *[target.GetPrim() for target in bound.targets], *([animation] if animation else [])]
    for prim in edited:
        if prim.IsInstanceProxy():
            return f"{prim.GetPath()} is below an instance"
        if prim.GetPath().GetPrefixes()[0] != bound.prim.GetPath().GetPrefixes()[0]:
            return f"{prim.GetPath()} is below another root prim"
    return None


def _hidden_skin(stage: Usd.Stage) -> str | None:
    """A skinned prim, by its place in its layer, in a variant that is not selected: it may count by the same joints."""
    return min((str(path.GetPrimPath()) for _, path in hidden_properties(stage, SKIN_PROPERTIES)), default=None)


def _reduce(bound: _Bound, animation: Usd.Prim | None) -> str | None:
    names = bound.names
    needed = {name for target in bound.targets for name in _used(target, names)}
    stays = np.array([name in needed for name in names])
    if stays.all() or not stays.any():
        return None
    query = bound.query.GetAnimQuery()
    times = list(query.GetJointTransformTimeSamples()) if query else []
    codes = [Usd.TimeCode(time) for time in times] or [Usd.TimeCode.EarliestTime()]
    local = [_local_transforms(bound.query, code) for code in codes]
    if any(len(each) != len(names) for each in local):
        return f"{bound.prim.GetPath()}: all joints stay, as rest transforms or animation do not place each of them"
    if any((np.abs(np.linalg.det(each[:, :3, :3])) < MIN_VOLUME).any() for each in local):
        return f"{bound.prim.GetPath()}: all joints stay, as one of them has a scale of zero at some time"
    rest = _local_transforms(bound.query, Usd.TimeCode.EarliestTime(), at_rest=True)
    rests = rest if len(rest) == len(names) else None
    parents = np.array([bound.query.GetTopology().GetParent(joint) for joint in range(len(names))])
    while True:
        composed = [_compose(each, stays, parents) for each in local]
        broken = [_decomposed(each[stays])[1] for each in composed]
        odd = np.flatnonzero(stays)[np.any(broken, axis=0)]
        above = [parents[joint] for joint in odd if parents[joint] >= 0 and not stays[parents[joint]]]
        if not above:
            break
        stays[above] = True
    if stays.all():
        return None
    kept = [name for name, stay in zip(names, stays, strict=True) if stay]
    for target in bound.targets:
        _own_order(target, names)
    _write_skeleton(bound, kept, stays, None if rests is None else _compose(rests, stays, parents))
    if animation is not None:
        _write_animation(UsdSkel.Animation(animation), kept, [each[stays] for each in composed], times)
    return f"{bound.prim.GetPath()}: {len(kept)} of {len(names)} joints stay"


def _local_transforms(query: UsdSkel.SkeletonQuery, code: Usd.TimeCode, *, at_rest: bool = False) -> Matrices:
    """(J, 4, 4) in the space of the joint above; (0, 4, 4) where the skeleton does not give them."""
    transforms = query.ComputeJointLocalTransforms(code, at_rest)
    return np.empty((0, 4, 4)) if not transforms else np.array(transforms)


def _used(target: UsdSkel.SkinningQuery, names: list[str]) -> set[str]:
    """Names of the joints that move a prim at any time."""
    order = _order(target, names)
    joints, weights = target.GetJointIndicesPrimvar(), target.GetJointWeightsPrimvar()
    used: set[str] = set()
    if not target.HasJointInfluences():
        return used
    for code in _codes(joints, weights):
        index, weight = (np.array(primvar.ComputeFlattened(code)) for primvar in (joints, weights))
        if index.shape != weight.shape or index.dtype.kind != "i":
            # Influences that no reader understands: what they mean is not known, so that all joints stay.
            return set(names)
        used |= {order[joint] for joint in np.unique(index[weight > 0]) if 0 <= joint < len(order)}
    return used


def _order(target: UsdSkel.SkinningQuery, names: list[str]) -> list[str]:
    order = target.GetJointOrder()
    return names if order is None else list(order)


def _codes(*primvars: UsdGeom.Primvar) -> list[Usd.TimeCode]:
    times = sorted({time for primvar in primvars for time in primvar.GetTimeSamples()})
    return [Usd.TimeCode(time) for time in times] or [Usd.TimeCode.Default()]


def _own_order(target: UsdSkel.SkinningQuery, names: list[str]) -> None:
    """Give a prim whose joints count through the skeleton an order of its own."""
    if not target.HasJointInfluences() or target.GetJointOrder() is not None:
        return
    own = sorted(_used(target, names), key=names.index)
    place = np.zeros(len(names), dtype=np.int32)
    place[[names.index(name) for name in own]] = np.arange(len(own))
    binding = UsdSkel.BindingAPI.Apply(target.GetPrim())
    inherited = target.GetJointIndicesPrimvar()
    values = {}
    for code in _codes(inherited):
        index = np.array(inherited.ComputeFlattened(code))
        values[code] = place[np.clip(index, 0, len(names) - 1)]
    constant = inherited.GetInterpolation() == UsdGeom.Tokens.constant
    primvar = binding.CreateJointIndicesPrimvar(constant, inherited.GetElementSize())
    if primvar.IsIndexed():
        primvar.BlockIndices()
    for code, index in values.items():
        primvar.Set(Vt.IntArray.FromNumpy(np.ascontiguousarray(index)), code)
    binding.CreateJointsAttr(Vt.TokenArray(own))


def _compose(local: Matrices, stays: npt.NDArray[np.bool_], parents: npt.NDArray[np.int64]) -> Matrices:
    """Transforms of joints in the space of the next joint above that stays; USD matrices act on row vectors."""
    composed = local.copy()
    for joint in np.flatnonzero(stays):
        above = parents[joint]
        while above >= 0 and not stays[above]:
            composed[joint] = composed[joint] @ local[above]
            above = parents[above]
    return composed


def _matrices(values: Matrices) -> Vt.Matrix4dArray:
    return Vt.Matrix4dArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float64))


def _decomposed(local: Matrices) -> tuple[tuple[Vt.Vec3fArray, Vt.QuatfArray, Vt.Vec3hArray], npt.NDArray[np.bool_]]:
    """Translations, rotations and scales of transforms, and which of them they do not give again."""
    parts = UsdSkel.DecomposeTransforms(_matrices(local))
    again = np.array(UsdSkel.MakeTransforms(*parts)).reshape(local.shape)
    size = np.maximum(np.abs(local).max(axis=(1, 2)), 1.0)
    return parts, np.abs(again - local).max(axis=(1, 2)) > TOLERANCE * size


def _write_skeleton(bound: _Bound, kept: list[str], stays: npt.NDArray[np.bool_], rests: Matrices | None) -> None:
    skeleton = UsdSkel.Skeleton(bound.prim)
    bind = skeleton.GetBindTransformsAttr().Get()
    labels = skeleton.GetJointNamesAttr().Get()
    skeleton.CreateJointsAttr(Vt.TokenArray(kept))
    if bind is not None and len(bind) == len(stays):
        skeleton.CreateBindTransformsAttr(_matrices(np.array(bind)[stays]))
    if rests is not None:
        skeleton.CreateRestTransformsAttr(_matrices(rests[stays]))
    if labels and len(labels) == len(stays):
        chosen = [label for label, stay in zip(labels, stays, strict=True) if stay]
        skeleton.CreateJointNamesAttr(Vt.TokenArray(chosen))


def _write_animation(animation: UsdSkel.Animation, kept: list[str], local: list[Matrices], times: list[float]) -> None:
    attributes = (animation.GetTranslationsAttr(), animation.GetRotationsAttr(), animation.GetScalesAttr())
    animation.CreateJointsAttr(Vt.TokenArray(kept))
    before: npt.NDArray[np.float64] | None = None
    for index, matrices in enumerate(local):
        translations, rotations, scales = _decomposed(matrices)[0]
        turns = np.array([[*turn.GetImaginary(), turn.GetReal()] for turn in rotations])
        if before is not None:
            # The same turn has two signs, and rotations between samples go the short way between them.
            turned = (turns * before).sum(axis=1) < 0
            turns[turned] *= -1
            rotations = Vt.QuatfArray([-turn if flip else turn for turn, flip in zip(rotations, turned, strict=True)])
        before = turns
        code = Usd.TimeCode(times[index]) if times else Usd.TimeCode.Default()
        for attribute, value in zip(attributes, (translations, rotations, scales), strict=True):
            attribute.Set(value, code)
            if index == 0 and times and attribute.Get(Usd.TimeCode.Default()) is not None:
                # A value without a time must not be as long as the old joints.
                attribute.Set(value, Usd.TimeCode.Default())
