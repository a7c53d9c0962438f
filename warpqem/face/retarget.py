"""Expression cloning: carry the motion of one face to another, or to a level of its own (Noh & Neumann 2001).

The source is morphed so that its feature points lie on the target's; every target vertex is projected from a cylinder's
axis to the point of the source that belongs to it; the motion vector there is turned and scaled as the morph turns and
scales space at that point. Motion of the whole head is taken off first, and put back on as it would move the target.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpqem.arguments.array_input import first_outside, real_array
from warpqem.arguments.array_record import ArrayRecord
from warpqem.arguments.array_types import ArrayInput, Points
from warpqem.arguments.number_input import shown
from warpqem.errors import FeaturePointError, MeshShapeError, OptionError
from warpqem.face.face_correspondence import FaceCorrespondence, LipLine, correspond
from warpqem.face.feature_points import FacialFeatures, facial_features
from warpqem.face.lips import keep_apart, lip_pairs
from warpqem.face.nose import FaceUnits
from warpqem.face.skin_regions import FaceSkin, find_skin, head_motion
from warpqem.face.volume_morph import VolumeMorph, shared_points
from warpqem.mesh.mesh_input import finite_points, read_mesh, read_points
from warpqem.runtime.device import on_device, resolve_device

__all__ = ["FaceMesh", "RetargetedMotion", "retarget"]

# Where the morphed source is so far from a vertex, in noses, motion begins to fade, and has faded: shoulders that the
# other mesh has not, hair, a mask's missing rest.
FADE_FROM, FADE_TO = 0.35, 0.9
# Lips this close to each other at rest, in noses, touch.
TOUCH = 0.05


@dataclass(frozen=True, eq=False, repr=False)
class FaceMesh(ArrayRecord):
    """A face at rest.

    Attributes:
        points: (V, 3), any unit.
        faces: (N, 3) vertex indices.
        features: its feature points; None finds them with +y up and +z forward.
    """

    points: ArrayInput
    faces: ArrayInput
    features: FacialFeatures | None = None


@dataclass(frozen=True, eq=False, repr=False)
class RetargetedMotion(ArrayRecord):
    """The target in motion.

    Attributes:
        points: (F, V', 3) float32.
        neutral: (V', 3) float32, the target at rest.
        share: (V',) float64, how much of the motion each vertex takes: less than 1 where the source has no surface.
        distance: (V',) float64, how far the morphed source is from each vertex, in noses of the target.
        shared: names of the feature points that both faces have.
    """

    points: np.ndarray
    neutral: np.ndarray
    share: np.ndarray
    distance: np.ndarray
    shared: tuple[str, ...]

    def blend_shapes(self, least: float = 1e-5) -> list[tuple[np.ndarray, np.ndarray]]:
        """One shape a frame: vertices (n,) int32 that move by more than a part of the target's size, offsets (n, 3)."""
        bound = least * float(np.linalg.norm(np.ptp(self.neutral, axis=0)))
        shapes = []
        for frame in self.points:
            offset = frame - self.neutral
            moving = np.flatnonzero(np.linalg.norm(offset, axis=1) > bound).astype(np.int32)
            shapes.append((moving, offset[moving].astype(np.float32)))
        return shapes


@on_device
def retarget(source: FaceMesh, target: FaceMesh, motion: Points, *, device: str | None = None) -> RetargetedMotion:
    """Move the target as the source moves.

    Args:
        source: the face that moves, at rest.
        target: the face to move, at rest: a level of the source, or another face of any topology.
        motion: (F, V, 3) frames of the source.
        device: Warp device; None takes cuda:0 if present, else cpu.

    Raises:
        FeaturePointError: the faces share too few feature points, or one has no nose.
        MeshShapeError: the motion has other vertices than the source.
        NonFinitePointError, FaceIndexError, DegenerateMeshError: see :mod:`warpqem.errors`.
    """
    device = resolve_device(device)
    for face, name in ((source, "source"), (target, "target")):
        if not isinstance(face, FaceMesh):
            raise OptionError(f"{name} must be a FaceMesh, got {shown(face)}")
    # Before features are looked for, which takes seconds.
    moving = read_points(real_array(motion, "motion", ("F", "V", 3)), "motion")
    frames = finite_points(moving, "motion:").astype(np.float64)
    a, b = _Prepared.of(source, frames.shape[1]), _Prepared.of(target)
    shared = shared_points(a.features, b.features)
    at = [[face.features.vertices[name] for name in shared] for face in (a, b)]
    morph = VolumeMorph(a.points[at[0]], b.points[at[1]], a.units.nose)
    used, skin = a.skin.vertices, b.skin.vertices
    morphed = np.full_like(a.points, np.nan)
    morphed[used] = morph(a.points[used])
    found = _match(a, b, morphed, device)
    rotation, shift = head_motion(np.concatenate([a.points[None], frames]), used)
    derivative = np.zeros((len(a.points), 3, 3))
    derivative[used] = morph.derivative(a.points[used])
    local = found.blend(derivative)
    share = np.ones(len(b.points))
    share[skin] = np.clip((FADE_TO - found.distance) / (FADE_TO - FADE_FROM), 0.0, 1.0)
    away = np.zeros(len(b.points))
    away[skin] = found.distance
    nearest = _nearest_skin(b.points, skin)
    # By the points that both have: on a level of the source they are the same, and so is then the head's motion.
    scale = _spread(b.points[at[1]]) / _spread(a.points[at[0]])
    tip = a.units.tip
    own = morph(tip[None])[0]
    turn = b.axes.T @ a.axes
    lips = _lip_pairs(b)
    points = np.empty((len(frames), *b.points.shape), dtype=np.float32)
    for index, posed in enumerate(frames):
        r, s = rotation[index + 1], shift[index + 1]
        vectors = posed @ r.T + s - a.points
        moved = np.einsum("tij,tj->ti", local, found.blend(vectors)) * share[skin, None]
        offset = np.zeros_like(b.points)
        offset[skin] = moved
        rest = b.points + offset
        if lips is not None:
            rest = keep_apart(rest, b.points, lips, b.axes[1])
        rest[b.others] = b.points[b.others] + (rest - b.points)[nearest[b.others]]
        # The head turns about the tip of the nose, and moves as far as its size says.
        about = turn @ r.T @ turn.T
        travel = turn @ (r.T @ (tip - s) - tip) * scale
        points[index] = (rest - own) @ about.T + own + travel
    return RetargetedMotion(points, b.points.astype(np.float32), share, away, shared)


@dataclass(frozen=True)
class _Prepared:
    """A face with what is known of it.

    Attributes:
        others: vertices that belong neither to the skin nor to an eyeball, such as lashes; they follow the skin.
    """

    points: np.ndarray
    faces: np.ndarray
    features: FacialFeatures
    units: FaceUnits
    skin: FaceSkin
    others: np.ndarray

    @property
    def axes(self) -> np.ndarray:
        return self.units.axes

    @property
    def local(self) -> np.ndarray:
        return self.units.local(self.points)

    @classmethod
    def of(cls, face: FaceMesh, vertex_count: int | None = None) -> _Prepared:
        """Look at a face, whose motion has so many vertices."""
        mesh = read_mesh(face.points, face.faces)
        if mesh.frame_count != 1:
            raise MeshShapeError(f"a face at rest has one pose, got {mesh.frame_count}")
        if vertex_count not in (None, mesh.vertex_count):
            raise MeshShapeError(
                f"motion must be (F, {mesh.vertex_count}, 3) like the source, got {vertex_count} vertices"
            )
        points = finite_points(mesh.source.read(slice(0, 1)))[0].astype(np.float64)
        features = face.features
        if features is None:
            features = facial_features(points, mesh.faces)
        if not isinstance(features, FacialFeatures):
            raise OptionError(f"features must be FacialFeatures or None, got {shown(features)}")
        outside = first_outside(features.indices, mesh.vertex_count)
        if outside is not None:
            raise OptionError(
                f"the feature point {features.names[outside[0]]} is vertex {features.indices[outside]}, but there are "
                f"{mesh.vertex_count} vertices"
            )
        if features.units is None:
            raise FeaturePointError("retargeting needs faces whose nose was found")
        faces = mesh.faces.astype(np.int64)
        skin = find_skin(points, faces)
        used = np.unique(faces)
        return cls(points, faces, features, features.units, skin, np.setdiff1d(used, np.unique(skin.seen)))


def _match(a: _Prepared, b: _Prepared, morphed: np.ndarray, device: str) -> FaceCorrespondence:
    """The point of the morphed source for each vertex of the target's skin."""
    used, skin = a.skin.vertices, b.skin.vertices
    # Vertices of the skins alone, numbered anew.
    number = np.full(len(a.points), -1)
    number[used] = np.arange(len(used))
    local, target = b.units.local(morphed[used]), b.local
    sides = [np.zeros(len(used), dtype=int), np.zeros(len(target), dtype=int)]
    lines = [LipLine.of(a.features, a.local), LipLine.of(b.features, target)]
    if lines[0] is not None and lines[1] is not None:
        sides = [lines[0].sides(a.local, a.skin.faces)[used], lines[1].sides(target, b.skin.faces)]
    found = correspond(local, number[a.skin.faces], sides[0], target[skin], sides[1][skin], device)
    return FaceCorrespondence(used[found.vertex], found.weight, found.distance)


def _spread(points: np.ndarray) -> float:
    """RMS distance of points (n, 3) from their mean: the size of a face."""
    return float(np.linalg.norm(points - points.mean(axis=0)) / np.sqrt(len(points)))


def _nearest_skin(points: np.ndarray, skin: np.ndarray) -> np.ndarray:
    from scipy.spatial import cKDTree

    return np.asarray(skin[cKDTree(points[skin]).query(points)[1]])


def _lip_pairs(face: _Prepared) -> np.ndarray | None:
    line = LipLine.of(face.features, face.local)
    if line is None:
        return None
    side = line.sides(face.local, face.skin.faces)
    own = np.zeros(len(side), dtype=int)
    own[face.skin.vertices] = side[face.skin.vertices]
    return lip_pairs(face.points, own, TOUCH * face.units.nose)
