"""Find the edges that values on a mesh do not cross: UV seams, hard edges, colour and subset borders, creases."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from warpqem.mesh.components import lowest_members
from warpqem.mesh.edges import edge_key
from warpqem.mesh.mesh_input import is_proper
from warpqem.pipeline.surface_transfer import joined_faces
from warpqem.repair.mended_mesh import MeshRepair
from warpqem.usd.read.descendants import subsets_of
from warpqem.usd.read.flat_shading import facet_signs
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.value_arrays import (
    Samples,
    element_size,
    is_normal,
    is_of_one_type,
    primvar_samples,
    sample_codes,
)

__all__ = ["DISPLAY_COLORS", "MeshSeams", "corner_values", "crease_edges", "face_values", "find_seams", "is_color"]

# Normals on two sides of an edge that differ by less than this angle are one smooth shading (cosine of 15 degrees, half
# the angle at which modelling tools harden edges by default).
SMOOTH_COSINE = float(np.cos(np.radians(15.0)))

# Real values that differ by less than this part of the largest are the same, rounded on two ways in single precision.
ROUNDING = 4 * float(np.finfo(np.float32).eps)

# Values whose seams end or fork at more than this share of the vertices are no islands with borders but values of
# single faces, as on a flat-shaded mesh. Held closed, such seams would leave next to nothing to simplify.
DENSE_SHARE = 0.25

# What a renderer colours a mesh by where no material does.
DISPLAY_COLORS = ("primvars:displayColor", "primvars:displayOpacity")

# The attributes that shade a mesh.
NORMALS = ("normals", "primvars:normals")

Pairs = npt.NDArray[np.int32]


@dataclass
class MeshSeams:
    """The seams of one mesh as pairs of vertices.

    Attributes:
        by_name: The seams of each attribute with one value per corner, and of colours and normals of faces, int32,
            shape (S, 2).
        borders: Subset borders and creases, int32, shape (S, 2).
        hard: Edges where shading breaks although no normals come along: creases, and where normals that are removed
            differ.
        dense: Names of the attributes whose seams are too many to be held closed.
        two_sided: Names of the attributes with other values on the back of a sheet with two sides.
        facets: Of normals by which some faces are shaded flat: what `facet_signs` gives for the triangles.
    """

    by_name: dict[str, Pairs] = field(default_factory=dict)
    borders: Pairs = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int32))
    hard: Pairs = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int32))
    dense: list[str] = field(default_factory=list)
    two_sided: list[str] = field(default_factory=list)
    facets: dict[str, npt.NDArray[np.int8]] = field(default_factory=dict)

    def add(self, name: str, pairs: Pairs, vertex_count: int) -> None:
        """Add the seams of one attribute."""
        self.by_name[name] = pairs
        if _corner_count(pairs) > DENSE_SHARE * vertex_count:
            self.dense.append(name)

    def hold(self) -> Pairs:
        """The edges that are to stay closed polylines during simplification, int32, shape (S, 2)."""
        named = [pairs for name, pairs in self.by_name.items() if name not in self.dense]
        return _distinct(np.concatenate([*named, self.borders]))

    def released(self, faces: npt.NDArray[np.int32], face_map: npt.NDArray[np.int32]) -> list[str]:
        """Released seams: what a simplified mesh no longer has of the seams, in words.

        Args:
            faces: int32, shape (N, 3), the triangles that the seams were found on.
            face_map: int32, shape (N',), the triangle that each face left goes on from.
        """
        gone = [f"closed seams of {name} (too many)" for name in self.dense]
        kinds = {f"islands of {name}": pairs for name, pairs in self.by_name.items() if name not in self.dense}
        for kind, pairs in {**kinds, "parts between subset borders and creases": self.borders}.items():
            if not len(pairs):
                continue
            island = lowest_members(len(faces), np.stack(joined_faces(faces, pairs), axis=1))
            before, after = len(np.unique(island[is_proper(faces)])), len(np.unique(island[face_map]))
            if after < before:
                gone.append(f"{before - after} of {before} {kind}")
        return gone


def _distinct(pairs: Pairs) -> Pairs:
    """Each of some pairs (S, 2) once, ascending; most meshes have none, which NumPy takes long to see."""
    if not len(pairs):
        return pairs.reshape(-1, 2)
    # As single numbers: NumPy takes several times as long to sort pairs.
    first, second = pairs.T.astype(np.int64)
    count = int(second.max()) + 1
    key = np.unique(first * count + second)
    return np.stack([key // count, key % count], axis=1).astype(pairs.dtype)


def _corner_count(pairs: Pairs) -> int:
    """Vertices where seams end or fork."""
    _, degree = np.unique(pairs, return_counts=True)
    return int((degree != 2).sum())


@dataclass(frozen=True)
class _InnerEdges:
    """Edges with two faces; an edge with more has an entry for each pair of consecutive ones.

    Attributes:
        ends: (E, 2) vertices, lower first.
        face: (E, 2) the two faces.
        corner: (E, 2, 2) for each face the corner (0 to 3N) at each end.
    """

    ends: npt.NDArray[np.int32]
    face: npt.NDArray[np.int64]
    corner: npt.NDArray[np.int64]

    @classmethod
    def of(cls, faces: npt.NDArray[np.int32], sheets: npt.NDArray[np.int32]) -> _InnerEdges:
        """The edges of all faces but those that welding closed, and between faces that share corners of ``sheets``."""
        tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
        key = edge_key(sheets.ravel(), np.roll(sheets, -1, axis=1).ravel(), int(sheets.max(initial=0)) + 1)
        proper = np.repeat(is_proper(sheets), 3)
        order = np.argsort(key, kind="stable")
        order = order[proper[order]]
        pair = np.flatnonzero(key[order[1:]] == key[order[:-1]])
        half_edges = np.stack([order[pair], order[pair + 1]], axis=1)
        following = half_edges - half_edges % 3 + (half_edges + 1) % 3
        upwards = tail[half_edges] < head[half_edges]
        corner = np.stack([np.where(upwards, half_edges, following), np.where(upwards, following, half_edges)], axis=2)
        return cls(faces.ravel()[corner[:, 0]].astype(np.int32), half_edges // 3, corner)

    def where(self, chosen: npt.NDArray[np.bool_]) -> Pairs:
        """The ends of some edges, each edge once."""
        return _distinct(self.ends[chosen])

    def values_differ(self, values: npt.NDArray[Any], normals: bool) -> npt.NDArray[np.bool_]:
        """Where values at corners, (3N, ...), differ between the two faces at either end.

        Normals by their angle, other real values beyond rounding.
        """
        first, second = values[self.corner[:, 0]], values[self.corner[:, 1]]
        # A mesh of one face has no inner edge, and an array of none cannot be reshaped to a width of its own.
        axes = tuple(range(1, first.ndim))
        if normals:
            # Of values of several elements each is a normal.
            first, second = first.astype(np.float64), second.astype(np.float64)
            lengths = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
            return np.asarray(((first * second).sum(axis=-1) < SMOOTH_COSINE * lengths).any(axis=axes[:-1]), dtype=bool)
        differ = np.asarray((first != second).any(axis=axes), dtype=bool)
        if values.dtype.kind == "f" and differ.any():
            finite = values[np.isfinite(values)].astype(np.float64)
            reach = ROUNDING * float(np.abs(finite).max(initial=0.0))
            # Infinity is as far from itself as from all others, which are equal or not.
            with np.errstate(invalid="ignore"):
                offset = np.abs(first[differ].astype(np.float64) - second[differ].astype(np.float64))
            differ[differ] = (~(offset <= reach) & (first[differ] != second[differ])).any(axis=axes)
        return differ


def find_seams(
    source: MeshSource,
    faces: npt.NDArray[np.int32],
    *,
    welded: bool = False,
    with_normals: bool = True,
    repair: MeshRepair | None = None,
) -> MeshSeams:
    """The seams of all faceVarying primvars and normals, of colours and normals of faces, of subsets, and the creases.

    Where points were welded, also those of point values that differ between the points that became one vertex.

    Args:
        source: The mesh.
        faces: int32, shape (N, 3), its triangles, in the order of `source.topology.triangles`, on whichever vertices
            the seams are to be named by.
        welded: True if some of these vertices are more than one point.
        with_normals: False if the mesh is going to lose its normals.
        repair: What is going to be mended of the topology of `faces`; None for nothing.

    Returns:
        The seams. Borders of the surface are none.
    """
    seams = MeshSeams()
    if not len(faces):
        return seams
    found = corner_values(source, welded) + face_values(source)
    if not (found or source.mesh.GetCreaseIndicesAttr().HasValue() or subsets_of(source.mesh)):
        return seams
    edges = _InnerEdges.of(faces, faces if repair is None else repair.sheets)
    sides, vertex_count = None if repair is None else repair.back_corners(), int(faces.max()) + 1
    creases = _creases(source, edges, faces)
    hard = [creases]
    for name, samples, normals in found:
        differ = np.zeros(len(edges.ends), dtype=bool)
        for values in samples.values():
            differ |= edges.values_differ(values, normals)
            if sides is not None and name not in seams.two_sided and (values[sides[0]] != values[sides[1]]).any():
                seams.two_sided.append(name)
        if name in NORMALS and not with_normals:
            hard.append(edges.where(differ))
            continue
        seams.add(name, edges.where(differ), vertex_count)
        signs = _facets(source, edges, samples) if name in NORMALS else None
        if signs is not None and signs.any():
            seams.facets[name] = signs
    seams.hard = _distinct(np.concatenate(hard)).astype(np.int32)
    borders = [_subset_borders(source, edges), creases]
    seams.borders = _distinct(np.concatenate(borders)).astype(np.int32)
    return seams


def corner_values(source: MeshSource, points_too: bool) -> list[tuple[str, Samples, bool]]:
    """Attributes with a value per corner, or also per point: name, samples at the triangles' corners, if normals."""
    topology = source.topology
    places = {UsdGeom.Tokens.faceVarying: (topology.corner_count, topology.triangle_corners.ravel())}
    if points_too:
        for interpolation in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying):
            places[interpolation] = (source.point_count, topology.triangles.ravel())
    return _values_at(source, places)


def face_values(source: MeshSource) -> list[tuple[str, Samples, bool]]:
    """Colours and normals with a value per face: name, samples at the triangles' corners, if normals.

    Other values of faces have no borders that show.
    """
    corner_polygon = np.repeat(source.topology.triangle_polygons, 3)
    found = _values_at(source, {UsdGeom.Tokens.uniform: (source.topology.polygon_count, corner_polygon)})
    return [entry for entry in found if entry[2] or is_color(source.prim.GetAttribute(entry[0]))]


def is_color(attribute: Usd.Attribute) -> bool:
    """True of what a mesh is coloured by: the display colour and opacity, and values that are declared as colours."""
    return attribute.GetName() in DISPLAY_COLORS or str(attribute.GetTypeName().role) == "Color"


def _values_at(
    source: MeshSource, places: Mapping[str, tuple[int, npt.NDArray[np.int32]]]
) -> list[tuple[str, Samples, bool]]:
    """Attributes with these interpolations, each with the count of its values and the one at each triangle corner."""
    found = []
    for name, interpolation, samples, normals in _authored_arrays(source):
        if interpolation in places:
            count, element = places[interpolation]
            if all(len(values) == count for values in samples.values()):
                found.append((name, samples.map(itemgetter(element)), normals))
    return found


def _facets(source: MeshSource, edges: _InnerEdges, samples: Samples) -> npt.NDArray[np.int8] | None:
    """Which triangles are shaded flat by normals, by their first sample; None where they are no vectors."""
    code, normals = next(iter(samples.items()))
    points = source.mesh.GetPointsAttr().Get(code) or source.mesh.GetPointsAttr().Get(Usd.TimeCode.EarliestTime())
    if normals.dtype.kind != "f" or normals.shape[1:] != (3,) or points is None or len(points) != source.point_count:
        return None
    topology = source.topology
    corners = np.asarray(points, dtype=np.float64)[topology.triangles]
    return facet_signs(normals, corners, edges.corner, topology.triangle_polygons)


def _authored_arrays(source: MeshSource) -> Iterator[tuple[str, str, Samples, bool]]:
    """Name, interpolation and samples of all primvars and normals, and whether they are normals."""
    for primvar in UsdGeom.PrimvarsAPI(source.prim).GetPrimvarsWithAuthoredValues():
        name, count = str(primvar.GetPrimvarName()), source.element_count(str(primvar.GetInterpolation()))
        samples = primvar_samples(primvar, element_size(primvar, count))
        if samples is not None and not name.startswith("skel:"):
            normals = is_normal(primvar.GetTypeName()) or name == "normals"
            yield primvar.GetAttr().GetName(), str(primvar.GetInterpolation()), samples, normals
    attribute = source.mesh.GetNormalsAttr()
    if attribute.HasAuthoredValue():
        samples = Samples(sample_codes(attribute), lambda code: np.array(attribute.Get(code)))
        if not is_of_one_type(attribute, list(samples)):
            return
        yield "normals", str(source.mesh.GetNormalsInterpolation()), samples, True


def _subset_borders(source: MeshSource, edges: _InnerEdges) -> Pairs:
    label = np.zeros(source.topology.polygon_count, dtype=np.int64)
    for subset in subsets_of(source.mesh):
        if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
            continue
        for code in sample_codes(subset.GetIndicesAttr()):
            members = np.asarray(subset.GetIndicesAttr().Get(code), dtype=np.int64)
            member = np.zeros(len(label), dtype=np.int64)
            member[members[(members >= 0) & (members < len(label))]] = 1
            _, label = np.unique(2 * label + member, return_inverse=True)
    face_label = label[source.topology.triangle_polygons]
    return edges.where(face_label[edges.face[:, 0]] != face_label[edges.face[:, 1]])


def crease_edges(source: MeshSource, faces: npt.NDArray[np.int32]) -> Pairs:
    """The creases of a mesh as ends of its edges, int32, shape (S, 2); arguments as for `find_seams`."""
    return _creases(source, _InnerEdges.of(faces, faces), faces)


def _creases(source: MeshSource, edges: _InnerEdges, faces: npt.NDArray[np.int32]) -> Pairs:
    indices = np.asarray(source.mesh.GetCreaseIndicesAttr().Get(Usd.TimeCode.EarliestTime()) or [], dtype=np.int64)
    lengths = np.asarray(source.mesh.GetCreaseLengthsAttr().Get(Usd.TimeCode.EarliestTime()) or [], dtype=np.int64)
    inside = len(indices) and indices.min() >= 0 and indices.max() < source.point_count
    if not inside or lengths.sum() != len(indices):
        return np.zeros((0, 2), dtype=np.int32)
    vertex_of_point = np.full(source.point_count, -1, dtype=np.int64)
    vertex_of_point[source.topology.triangles.ravel()] = faces.ravel()
    chain = np.repeat(np.arange(len(lengths)), lengths)
    within = chain[1:] == chain[:-1]
    tail, head = vertex_of_point[indices[:-1][within]], vertex_of_point[indices[1:][within]]
    used = (tail >= 0) & (head >= 0)
    vertex_count = int(faces.max()) + 1
    wanted = edge_key(tail[used], head[used], vertex_count)
    return edges.where(np.isin(edge_key(edges.ends[:, 0], edges.ends[:, 1], vertex_count), wanted))
