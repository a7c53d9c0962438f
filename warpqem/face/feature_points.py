"""``warpqem.face.facial_features``: the named feature points of a face mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from warpqem.arguments.array_input import finite_array, first_outside
from warpqem.arguments.array_record import ArrayRecord
from warpqem.arguments.array_types import ArrayInput, MeshPoints
from warpqem.arguments.number_input import shown
from warpqem.errors import OptionError
from warpqem.face.detect import find_spots
from warpqem.face.feature_names import FEATURE_NAMES
from warpqem.face.needs import need_scipy
from warpqem.face.nose import FaceUnits
from warpqem.face.orientation import axes_of, find_face
from warpqem.face.skin_regions import find_skin
from warpqem.face.spots import Missing, Spot
from warpqem.frames.checked_frames import BrokenPoints
from warpqem.mesh.mesh_input import MeshInput, read_mesh

__all__ = ["FacialFeatures", "facial_features", "features_any_way", "features_of"]

# Frames beyond these tell no more about how lips part; they are spread over the animation.
MAX_FRAMES = 64
# From the root of the nose to the chin are two of the three equal parts of a face below the hair.
FACE_PER_LOWER = 1.5


@dataclass(frozen=True, eq=False, repr=False)
class FacialFeatures(ArrayRecord):
    """Named vertices of a face.

    Attributes:
        vertices: vertex of each point that was found, by the names in :data:`warpqem.face.FEATURE_NAMES`.
        confidence: 0 to 1 for each of them; 1 for those that the caller named.
        missing: why each of the others was not found.
        axes: (3, 3) float64, unit vectors to the person's left, up and forward.
        units: face's own coordinates; None where no nose was found.
        given: names that the caller named.
    """

    vertices: dict[str, int]
    confidence: dict[str, float]
    missing: dict[str, str]
    axes: np.ndarray
    units: FaceUnits | None = None
    given: frozenset[str] = field(default_factory=frozenset)

    @property
    def names(self) -> tuple[str, ...]:
        """The points that were found, in the order of all names."""
        return tuple(name for name in FEATURE_NAMES if name in self.vertices)

    @property
    def indices(self) -> np.ndarray:
        """(n,) int32, the vertices of :attr:`names`."""
        return np.array([self.vertices[name] for name in self.names], dtype=np.int32)

    def moved(self, vertex: np.ndarray) -> FacialFeatures:
        """The same points on a mesh where vertices have other numbers, ``vertex`` (V,): a level's ``vertex_map``."""
        return replace(self, vertices={name: int(vertex[index]) for name, index in self.vertices.items()})

    def face_height(self, points: ArrayInput) -> float | None:
        """Height of the face from chin to hair in points (V, 3): half as much again as from chin to nose root."""
        if not {"nose_top", "chin"} <= self.vertices.keys():
            return None
        pose = finite_array(points, "points", ("V", 3))
        if first_outside(self.indices, len(pose)) is not None:
            raise OptionError(f"a feature point is vertex {int(self.indices.max())}, points has {len(pose)}")
        span = pose[self.vertices["nose_top"]] - pose[self.vertices["chin"]]
        return FACE_PER_LOWER * float(np.linalg.norm(span))


def facial_features(
    points: MeshPoints,
    faces: ArrayInput | None = None,
    *,
    up: str | None = "+y",
    forward: str | None = "+z",
    overrides: Mapping[str, int | None] | None = None,
) -> FacialFeatures:
    """Find the feature points of a face, in the first frame, by walks over local extrema of its surface.

    Args:
        points: (F, V, 3) or (V, 3) coordinates in any unit, as for :func:`warpqem.simplify`. Where lips part in later
            frames, that tells where they meet; where lids close, how far out the eyes are.
        faces: (N, 3) vertex indices. The largest component is taken for the skin.
        up: axis that points up, "+y" or "-z" for instance; None to find it.
        forward: axis that points out of the face; None to find it. Both or none are given.
        overrides: vertices of points by name, taken as they are; None says that the face has no such point.

    Returns:
        Up to 32 points. What is not found is reported as missing, with the reason.

    Raises:
        OptionError: an axis that is none, or the same twice; an override of an unknown name or vertex.
        MeshShapeError, NonFinitePointError, FaceIndexError, DegenerateMeshError: see :mod:`warpqem.errors`.
    """
    if (up is None) != (forward is None):
        raise OptionError(f"up {up!r} and forward {forward!r}: both or none must be given")
    return features_of(read_mesh(points, faces), up, forward, overrides)


def features_any_way(
    mesh: MeshInput, up: str, forward: str, overrides: Mapping[str, int | None] | None = None
) -> FacialFeatures:
    """The same where the face may look another way: along these axes, or any way round if no nose is found so."""
    features = features_of(mesh, up, forward, overrides)
    if features.units is not None:
        return features
    turned = features_of(mesh, None, None, overrides)
    return features if turned.units is None else turned


def features_of(
    mesh: MeshInput, up: str | None, forward: str | None, overrides: Mapping[str, int | None] | None = None
) -> FacialFeatures:
    """The same for a mesh that has been read."""
    need_scipy()
    given = _check_overrides(overrides, mesh.vertex_count)
    chosen = np.unique(np.linspace(0, mesh.frame_count - 1, min(mesh.frame_count, MAX_FRAMES)).round().astype(int))
    frames = np.concatenate([_finite_frame(mesh, int(frame)) for frame in chosen])
    own = mesh.faces.astype(np.int64)
    skin = find_skin(frames[0], own)
    if up is None or forward is None:
        face, axes = find_face(frames, skin)
    else:
        axes = axes_of(up, forward)
        face = find_spots(frames, skin, axes)
    no_nose = Missing("no nose stands out of the surface")
    spots: dict[str, Spot | Missing] = {}
    spots |= dict.fromkeys(FEATURE_NAMES, no_nose) if face is None else face.spots
    units = None if face is None else face.units
    return _to_vertices(spots, units, frames[0], skin.vertices, axes, given)


def _finite_frame(mesh: MeshInput, frame: int) -> np.ndarray:
    """One frame (1, V, 3) float64."""
    points = mesh.source.read(slice(frame, frame + 1))
    broken = BrokenPoints.add(None, points, frame)
    if broken is not None:
        raise broken.error()
    return points.astype(np.float64)


def _check_overrides(overrides: Mapping[str, int | None] | None, vertex_count: int) -> dict[str, int | None]:
    if overrides is not None and not isinstance(overrides, Mapping):
        raise OptionError(f"overrides must map names of feature points to vertices, got {shown(overrides)}")
    for name, vertex in (overrides or {}).items():
        if name not in FEATURE_NAMES:
            raise OptionError(f"there is no feature point {name!r}; there are {', '.join(FEATURE_NAMES)}")
        is_index = isinstance(vertex, (int, np.integer)) and not isinstance(vertex, bool)
        if vertex is not None and not (is_index and 0 <= vertex < vertex_count):
            raise OptionError(f"feature point {name}: vertex {vertex!r}, but there are {vertex_count} vertices")
    return {name: None if vertex is None else int(vertex) for name, vertex in (overrides or {}).items()}


def _to_vertices(
    spots: dict[str, Spot | Missing],
    units: FaceUnits | None,
    points: np.ndarray,
    skin: np.ndarray,
    axes: np.ndarray,
    given: dict[str, int | None],
) -> FacialFeatures:
    """The vertex of the skin nearest to each place."""
    local = None if units is None else units.local(points[skin])
    vertices, confidence, missing = {}, {}, {}
    for name, spot in spots.items():
        if name in given:
            if given[name] is None:
                missing[name] = "the caller says that there is none"
            else:
                vertices[name], confidence[name] = int(given[name] or 0), 1.0
        elif isinstance(spot, Missing) or local is None:
            missing[name] = spot.reason if isinstance(spot, Missing) else "no nose stands out of the surface"
        else:
            distance = np.linalg.norm(local - (spot.left, spot.up, spot.forward), axis=1)
            vertices[name] = int(skin[int(distance.argmin())])
            confidence[name] = spot.confidence
    return FacialFeatures(vertices, confidence, missing, axes, units, frozenset(given))
