"""A copy of a mesh's topology that decimation can work on, with what was found on the way."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.decimation.adjacency import build_adjacency, classify_vertices
from warpqem.kernels.clean_topology import find_unclean_vertices
from warpqem.mesh.components import lowest_members
from warpqem.repair.face_pairing import EdgePairs, distinct_faces, pair_faces, turned_faces
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.part_launches import FIRST_ITEM, launch_in_parts

__all__ = ["TopologyFindings", "TopologyRepair", "look_for_unclean", "repair_topology"]

# Sheets stay joined where no more than this part of the vertices has several, as these then keep their place: of the
# vertices of a mesh with a tenth of its faces they are ten times as much. With 0.3 to 0.5 % of the vertices held, three
# meshes had 7 % more RMS at a tenth of the faces, 11 to 14 % at a twentieth, half again to twice as much at a fiftieth;
# with less than 0.2 % there was no difference.
HELD_SHARE = 0.002
# In small meshes so many vertices may be held, where they are no more than this part.
HELD_COUNT, HELD_SHARE_OF_FEW = 4, 0.01
# Faces of meshes that are known again: up to so many, a look at the faces takes longer than to compare them.
REMEMBERED_FACES = 20000
# Meshes that are known again, until all are forgotten: many more than a stage reads before it simplifies the first one.
REMEMBERED_MESHES = 1024
_known_clean: dict[tuple[bytes, np.dtype, int, str], bool] = {}


@dataclass(frozen=True)
class TopologyFindings:
    """What is dirty about a topology.

    Attributes:
        repeated_faces: faces with the same vertices and winding as an earlier one. They are left out.
        double_sided_faces: faces with the vertices of an earlier one and the other winding. They stay, as the back of
            a sheet with two sides.
        turned_faces: faces whose winding was not that of most faces around. They are turned over.
        branching_edges: edges with more than two faces, both sides of one counted once.
        touching_vertices: vertices where parts of the surface meet in nothing but this point.
        one_sided_edges: edges that a surface with one side only, such as a Möbius strip, keeps between faces of unlike
            winding.
        is_cut: whether the surface was cut at all these edges and vertices; otherwise they keep their place.
    """

    repeated_faces: int = 0
    double_sided_faces: int = 0
    turned_faces: int = 0
    branching_edges: int = 0
    touching_vertices: int = 0
    one_sided_edges: int = 0
    is_cut: bool = False

    def lines(self) -> list[str]:
        """The same in words, one line for each kind that was found."""
        what_then = "cut" if self.is_cut else "held in place"
        words = {
            "faces that repeat another, left out": self.repeated_faces,
            "faces on the back of another, kept as its other side": self.double_sided_faces,
            "faces wound unlike most around them, turned over": self.turned_faces,
            f"edges with more than two faces, {what_then}": self.branching_edges,
            f"vertices where surfaces touch in a point, {what_then}": self.touching_vertices,
            f"edges where a one-sided surface changes its winding, {what_then}": self.one_sided_edges,
        }
        return [f"{what}: {count}" for what, count in words.items() if count]


@dataclass(frozen=True)
class TopologyRepair:
    """A mesh of V vertices and N faces as M faces on V' vertices that decimation can work on.

    Attributes:
        kept: (M,) int32, the face of the input that each one is.
        faces: (M, 3) int32, their corners.
        turned: (M,) bool, those whose corners are in the reverse order.
        back: (M,) int32, the face of the input on the same vertices with the other winding; -1 where there is none.
        vertex: (V',) int32, the input vertex that each vertex is: the V themselves, then copies.
        findings: what was mended.
    """

    kept: np.ndarray
    faces: np.ndarray
    turned: np.ndarray
    back: np.ndarray
    vertex: np.ndarray
    findings: TopologyFindings


def repair_topology(faces: np.ndarray, vertex_count: int, device: str) -> TopologyRepair | None:
    """Mend the topology of faces (N, 3) int32, each with three different vertices; None where nothing is to mend.

    Faces that repeat another one are left out, and connected parts get one winding, that of most of their faces. Edges
    and vertices where more than one sheet of the surface meets are cut, each sheet with copies of the vertices, unless
    they are so few that decimation can go around them. So are the edges where a surface with one side only, such as a
    Möbius strip or a tangle of handles, has faces of unlike winding: their ends could not collapse either.
    """
    if _is_clean(faces, vertex_count, device):
        return None
    distinct = distinct_faces(faces)
    kept, back = distinct.kept, distinct.back
    corner = faces[kept]
    pairs = pair_faces(corner, vertex_count)
    double = back >= 0
    turned = turned_faces(pairs, ~double)
    changes = _winding_changes(pairs, turned)
    fan = _fans(len(corner), pairs.half_edge[~changes], pairs.opposed[~changes])
    split, vertex = _split_vertices(corner, fan, vertex_count)
    joined = len(np.unique(vertex[vertex_count:]))
    used = len(np.unique(corner))
    is_cut = joined > max(HELD_SHARE * used, min(HELD_COUNT, HELD_SHARE_OF_FEW * used))
    if not is_cut:
        split, vertex = corner.copy(), np.arange(vertex_count, dtype=np.int32)
    findings = TopologyFindings(
        distinct.repeated,
        int(double.sum()),
        int((turned & ~double).sum()),
        len(pairs.branching),
        _touching(corner, fan, np.append(pairs.branching, _ends(corner, pairs.half_edge[changes, 0]))),
        int(changes.sum()),
        is_cut,
    )
    split[turned] = split[turned][:, ::-1]
    # Turned over, a face with two sides is its other side.
    kept, back = np.where(turned & double, back, kept), np.where(turned & double, kept, back)
    if not findings.lines():
        return None
    return TopologyRepair(kept.astype(np.int32), split, turned & ~double, back.astype(np.int32), vertex, findings)


def _is_clean(faces: np.ndarray, vertex_count: int, device: str) -> bool:
    """Whether the faces around each vertex are one fan, and no two faces have the same vertices."""
    if len(faces) > REMEMBERED_FACES or not device_traits(device).splits_launches:
        return _found_clean(faces, vertex_count, device)
    return _remembered_clean(faces, vertex_count, device)


def _remembered_clean(faces: np.ndarray, vertex_count: int, device: str) -> bool:
    """The same for a small mesh on a CPU, which is asked for when it is read, planned and simplified."""
    key = hashlib.blake2b(faces.tobytes(), digest_size=16).digest(), faces.dtype, vertex_count, device
    known = _known_clean.get(key)
    if known is None:
        known = _found_clean(faces, vertex_count, device)
        if len(_known_clean) >= REMEMBERED_MESHES:
            _known_clean.clear()
        _known_clean[key] = known
    return known


def _found_clean(faces: np.ndarray, vertex_count: int, device: str) -> bool:
    """The same, looked for."""
    corner_vertex = new_arrays.uploaded(faces.ravel(), dtype=wp.int32, device=device)
    return not look_for_unclean(corner_vertex, vertex_count).numpy()[0]


def look_for_unclean(corner_vertex: wp.array, vertex_count: int) -> wp.array:
    """(1,) int32 on the device, 1 where :func:`repair_topology` may find something to mend.

    Args:
        corner_vertex: (3N,) int32 on the device, -1 in faces that are left out.
        vertex_count: vertices V.
    """
    device = str(corner_vertex.device)
    flags = new_arrays.zeros(vertex_count, dtype=wp.int32, device=device)
    adjacency = build_adjacency(corner_vertex, vertex_count)
    classify_vertices(corner_vertex, adjacency, flags)
    is_unclean = new_arrays.zeros(1, dtype=wp.int32, device=device)
    inputs = [corner_vertex, adjacency.lists, flags, FIRST_ITEM]
    launch_in_parts(find_unclean_vertices, vertex_count, inputs, [is_unclean], device=device)
    return is_unclean


def _winding_changes(pairs: EdgePairs, turned: np.ndarray) -> np.ndarray:
    """(P,) bool, pairs of faces that have unlike windings also when some faces (M,) bool are turned over."""
    one, other = (pairs.half_edge // 3).T
    return np.asarray(pairs.opposed == (turned[one] ^ turned[other]))


def _ends(faces: np.ndarray, half_edge: np.ndarray) -> np.ndarray:
    """The vertices where half-edges of faces (M, 3) begin and end."""
    return np.append(faces.ravel()[half_edge], np.roll(faces, -1, axis=1).ravel()[half_edge])


def _fans(face_count: int, half_edge: np.ndarray, opposed: np.ndarray) -> np.ndarray:
    """(3M,) the lowest corner of the fan of faces that each corner is in, by pairs as in :class:`EdgePairs`."""
    one, other = half_edge.T
    next_one, next_other = (h - h % 3 + (h + 1) % 3 for h in (one, other))
    at_tail, at_head = np.where(opposed, next_other, other), np.where(opposed, other, next_other)
    links = np.concatenate([np.stack([one, at_tail], axis=1), np.stack([next_one, at_head], axis=1)])
    return lowest_members(3 * face_count, links)


def _split_vertices(faces: np.ndarray, fan: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Faces (M, 3) int32 whose fans at a vertex have a vertex each, and (V',) int32, which vertex each one was."""
    corner_vertex = faces.ravel()
    heads = np.flatnonzero(fan == np.arange(len(fan)))
    # The first fan of each vertex keeps it.
    _, first = np.unique(corner_vertex[heads], return_index=True)
    others = np.delete(heads, first)
    place = corner_vertex.copy()
    place[others] = vertex_count + np.arange(len(others))
    vertex = np.concatenate([np.arange(vertex_count), corner_vertex[others]])
    return place[fan].reshape(-1, 3).astype(np.int32), vertex.astype(np.int32)


def _touching(faces: np.ndarray, fan: np.ndarray, cut: np.ndarray) -> int:
    """Vertices with more than one fan that are no end (n,) of an edge that was cut."""
    heads = np.flatnonzero(fan == np.arange(len(fan)))
    vertex, count = np.unique(faces.ravel()[heads], return_counts=True)
    return len(np.setdiff1d(vertex[count > 1], cut))
