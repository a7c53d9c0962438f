"""Which faces go on across which edges: two at each edge, of which the input may have any number.

The rules are those of Guéziec, Taubin, Lazarus and Horn, "Cutting and stitching: converting sets of polygons to
manifold surfaces" (2001): a non-manifold surface becomes one with borders by cutting along what is not manifold, and
faces that belong together are stitched again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpqem.mesh.components import lowest_members
from warpqem.mesh.edges import edge_key

__all__ = ["DistinctFaces", "EdgePairs", "distinct_faces", "pair_faces", "runs", "turned_faces"]


@dataclass(frozen=True)
class DistinctFaces:
    """The faces of a mesh of N faces, one for each three vertices.

    Attributes:
        kept: (M,) int, the first face on each three vertices, ascending.
        back: (M,) int, the first face on the same vertices with the other winding; -1 where there is none.
        repeated: faces that are neither.
    """

    kept: np.ndarray
    back: np.ndarray
    repeated: int


def distinct_faces(faces: np.ndarray) -> DistinctFaces:
    """Find the faces (N, 3), each with three different vertices, that repeat no other."""
    ordered = np.sort(faces, axis=1)
    order = np.lexsort((ordered[:, 2], ordered[:, 1], ordered[:, 0]))
    ordered = ordered[order]
    group = np.empty(len(faces), dtype=np.int64)
    group[order] = np.cumsum(np.append(False, (ordered[1:] != ordered[:-1]).any(axis=1)))
    # Two faces on the same vertices have the same winding where both are even, or both odd, permutations of these.
    first = faces.argmin(axis=1)
    rows = np.arange(len(faces))
    odd = faces[rows, (first + 1) % 3] > faces[rows, (first + 2) % 3]
    _, front = np.unique(group, return_index=True)
    behind = np.flatnonzero(odd != odd[front][group])
    owner, first_behind = np.unique(group[behind], return_index=True)
    back = np.full(len(front), -1, dtype=np.int64)
    back[owner] = behind[first_behind]
    by_index = np.argsort(front)
    return DistinctFaces(front[by_index], back[by_index], len(faces) - len(front) - len(owner))


@dataclass(frozen=True)
class EdgePairs:
    """Pairs of half-edges of M faces: half-edge ``3 f + k`` runs from corner ``k`` of face ``f`` to the next.

    Attributes:
        half_edge: (P, 2) int, two half-edges of the same edge, whose faces go on from each other.
        opposed: (P,) bool, they run in opposite directions, as those of faces with the same winding do.
        branching: (B, 2) int, the ends of edges where more than two faces meet.
    """

    half_edge: np.ndarray
    opposed: np.ndarray
    branching: np.ndarray


def pair_faces(faces: np.ndarray, vertex_count: int) -> EdgePairs:
    """Pair the half-edges of faces (M, 3), no two of which have the same vertices.

    At an edge with more than two, faces go together that are joined elsewhere; of what is left those with the same
    winding.
    """
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = edge_key(tail, head, vertex_count)
    order = np.argsort(key, kind="stable")
    first, count = runs(key[order])
    pair = first[count == 2]
    found = [np.stack([order[pair], order[pair + 1]], axis=1)]
    crowded = order[np.repeat(count > 2, count)]
    branching = key[order[first[count > 2]]]
    if len(crowded):
        # Parts of the surface that edges with two faces join.
        part = np.repeat(lowest_members(len(faces), found[0] // 3), 3)
        crowded = crowded[np.lexsort((crowded, part[crowded], key[crowded]))]
        first, count = runs(np.stack([key[crowded], part[crowded]], axis=1))
        pair = first[count == 2]
        found.append(np.stack([crowded[pair], crowded[pair + 1]], axis=1))
        left = crowded[np.repeat(count != 2, count)]
        found.append(_pair_by_direction(left, *runs(key[left]), tail < head))
    half_edge = np.concatenate(found)
    opposed = tail[half_edge[:, 0]] == head[half_edge[:, 1]]
    return EdgePairs(half_edge, opposed, np.stack([branching // vertex_count, branching % vertex_count], axis=1))


def runs(labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where runs of equal rows begin, and how long they are."""
    if not len(labels):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    differs = labels[1:] != labels[:-1]
    first = np.flatnonzero(np.append(True, differs if differs.ndim == 1 else differs.any(axis=1)))
    return first, np.diff(np.append(first, len(labels)))


def _pair_by_direction(half_edges: np.ndarray, first: np.ndarray, count: np.ndarray, upwards: np.ndarray) -> np.ndarray:
    """Pairs (P, 2) of one half-edge upwards and one downwards within each run, in the order they come."""
    up, run = upwards[half_edges], np.repeat(np.arange(len(first)), count)
    pairs = []
    # The rank of each among those of its run that run the same way.
    for way in (True, False):
        chosen = np.flatnonzero(up == way)
        start, size = runs(run[chosen])
        rank = np.arange(len(chosen)) - np.repeat(start, size)
        pairs.append((run[chosen], rank, half_edges[chosen]))
    width = 1 + max((int(rank.max(initial=0)) for _, rank, _ in pairs), default=0)
    keys = [run * width + rank for run, rank, _ in pairs]
    _, mine, others = np.intersect1d(*keys, return_indices=True)
    return np.stack([pairs[0][2][mine], pairs[1][2][others]], axis=1)


def turned_faces(pairs: EdgePairs, single: np.ndarray) -> np.ndarray:
    """(M,) bool, faces to be turned over so that all of a connected part have the winding that most of its faces have.

    Where both windings have as many faces, that of the first face. Parts with one side only, such as a Möbius strip,
    keep a few pairs of unlike winding.

    Args:
        pairs: of the faces.
        single: (M,) bool, faces that have one winding; those with both do not vote.
    """
    count = len(single)
    face = pairs.half_edge // 3
    # Two nodes a face, one as it is and one turned over: what agrees is linked.
    one, other = 2 * face[:, 0], 2 * face[:, 1]
    unlike = (~pairs.opposed).astype(np.int64)
    links = np.concatenate([np.stack([one, other + unlike], axis=1), np.stack([one + 1, other + 1 - unlike], axis=1)])
    label = lowest_members(2 * count, links).reshape(-1, 2)
    turned = label[:, 0] > label[:, 1]
    part = label.min(axis=1) // 2
    one_sided = np.flatnonzero(label[:, 0] == label[:, 1])
    if len(one_sided):
        # Each part as it is, unless walks over it leave fewer pairs of unlike winding.
        walked = _spread_winding(one_sided, face, unlike == 1)
        left = unlike ^ walked[face[:, 0]] ^ walked[face[:, 1]]
        gain = np.bincount(part[face[:, 0]], weights=unlike - left, minlength=count)
        turned[one_sided] = walked[one_sided] & (gain > 0)[part[one_sided]]
    size = np.bincount(part[single], minlength=count)
    flipped = np.bincount(part[single & turned], minlength=count)
    turned ^= (2 * flipped > size)[part]
    return turned


def _spread_winding(faces: np.ndarray, pair: np.ndarray, unlike: np.ndarray) -> np.ndarray:
    """The windings that walks from the first face of each part give, (M,) bool; of ``faces`` only."""
    count = int(max(faces.max(), pair.max())) + 1
    turned, known, pending = np.zeros(count, dtype=bool), np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
    known[faces] = False
    pending[faces] = True
    ends = np.concatenate([pair, pair[:, ::-1]])
    differs = np.concatenate([unlike, unlike])
    while pending.any():
        seed = int(np.argmax(pending))
        known[seed], pending[seed] = True, False
        while True:
            reached = np.flatnonzero(known[ends[:, 0]] & pending[ends[:, 1]])
            if not len(reached):
                break
            target, first = np.unique(ends[reached, 1], return_index=True)
            via = reached[first]
            turned[target] = turned[ends[via, 0]] ^ differs[via]
            known[target], pending[target] = True, False
    return turned
