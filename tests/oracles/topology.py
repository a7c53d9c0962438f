"""Adjacency, fans, and what a collapse does to a list of faces."""

from collections import Counter

import numpy as np

BORDER, LOCKED, NON_MANIFOLD = 1, 2, 4


def adjacency(faces, vertex_count) -> list[list[int]]:
    """Corners of each vertex, ascending."""
    result = [[] for _ in range(vertex_count)]
    for corner, v in enumerate(np.asarray(faces).ravel()):
        result[v].append(corner)
    return result


def fan_count(faces, v) -> int:
    """Classes of the faces at ``v``, linked across each edge at ``v`` that runs both ways once; -1 for a bad edge."""
    at = [tuple(np.roll(f, -list(f).index(v))) for f in np.asarray(faces).tolist() if v in f]
    out, into = Counter(f[1] for f in at), Counter(f[2] for f in at)
    if max([*out.values(), *into.values()], default=0) > 1:
        return -1
    after = {f[1]: f for f in at}
    seen, fans = set(), 0
    for start in at:
        if start in seen:
            continue
        fans += 1
        waiting = [start]
        while waiting:
            face = waiting.pop()
            if face in seen:
                continue
            seen.add(face)
            waiting += [f for f in at if f[2] == face[1]]
            if face[2] in after:
                waiting.append(after[face[2]])
    return fans


def vertex_flags(faces, vertex_count) -> np.ndarray:
    """BORDER where an edge at the vertex lacks its opposite, NON_MANIFOLD where the faces are not one fan."""
    directed = {(f[k], f[(k + 1) % 3]) for f in np.asarray(faces).tolist() for k in range(3)}
    flags = np.zeros(vertex_count, dtype=np.int32)
    for a, b in directed:
        if (b, a) not in directed:
            flags[[a, b]] |= BORDER
    for v in np.unique(faces):
        if fan_count(faces, int(v)) != 1:
            flags[v] |= NON_MANIFOLD
    return flags


def collapsed(faces, kept, removed) -> np.ndarray:
    """The faces after ``removed`` became ``kept`` and faces that use it twice are gone."""
    f = np.where(np.asarray(faces) == removed, kept, faces)
    return f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]


def euler(faces) -> int:
    edges = {tuple(sorted((f[k], f[(k + 1) % 3]))) for f in np.asarray(faces).tolist() for k in range(3)}
    return len(np.unique(faces)) - len(edges) + len(faces)


def keeps_manifold(faces, u, v) -> bool:
    """Whether collapsing edge ``u v`` of a manifold mesh keeps fans, Euler number, borders, and distinct faces."""
    after = collapsed(faces, u, v)
    if len(after) == 0 or len({tuple(sorted(f)) for f in after.tolist()}) != len(after):
        return False
    before_ring = {w for f in np.asarray(faces).tolist() if u in f or v in f for w in f} - {v}
    if not before_ring <= set(after.ravel().tolist()):
        return False
    flags_before = vertex_flags(faces, int(np.max(faces)) + 1)
    flags = vertex_flags(after, int(np.max(faces)) + 1)
    if any(flags[w] & NON_MANIFOLD for w in before_ring) or euler(after) != euler(faces):
        return False
    return all((flags[w] & BORDER) == (flags_before[w] & BORDER) for w in before_ring - {u})


def closed_neighbourhood(faces, vertices) -> set[int]:
    """The vertices and all that share a face with one of them."""
    return {w for f in np.asarray(faces).tolist() if not vertices.isdisjoint(f) for w in f} | set(vertices)


def edges(faces) -> list[tuple[int, int]]:
    """Undirected edges, lower vertex first, ascending."""
    return sorted({tuple(sorted((f[k], f[(k + 1) % 3]))) for f in np.asarray(faces).tolist() for k in range(3)})
