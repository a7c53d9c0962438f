"""Dihedral angles, motion features and edge-length deformation."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components


def dihedral_angle(p, q, left, right) -> float:
    """Signed angle in radians between the faces ``p q left`` and ``q p right``: 0 flat, positive at a ridge."""
    n, m = np.cross(q - p, left - p), np.cross(right - p, q - p)
    n, m = n / np.linalg.norm(n), m / np.linalg.norm(m)
    # A ridge: the far wing lies below the first face's plane.
    sign = 1.0 if (right - p) @ n <= 0 else -1.0
    return sign * float(np.arccos(np.clip(n @ m, -1, 1)))


def edge_opposites(faces) -> dict[tuple[int, int], list[tuple[int, int, int]]]:
    """Undirected edge to the half-edges (tail, head, opposite vertex) along it."""
    result = {}
    for f in np.asarray(faces).tolist():
        for k in range(3):
            a, b, c = f[k], f[(k + 1) % 3], f[(k + 2) % 3]
            result.setdefault((min(a, b), max(a, b)), []).append((a, b, c))
    return result


def dihedral_changes(points, faces) -> dict[tuple[int, int], float]:
    """Largest change in degrees between consecutive frames; 0 for edges without exactly two faces."""
    x = np.asarray(points, dtype=np.float64)
    result = {}
    for edge, sides in sorted(edge_opposites(faces).items()):
        result[edge] = 0.0
        if len(sides) != 2:
            continue
        p, q = edge
        left = next((c for a, _, c in sides if a == p), sides[0][2])
        right = next((c for a, _, c in sides if a == q), sides[1][2])
        angle = [dihedral_angle(frame[p], frame[q], frame[left], frame[right]) for frame in x]
        steps = np.abs((np.diff(angle) + np.pi) % (2 * np.pi) - np.pi)
        result[edge] = float(np.degrees(steps.max(initial=0.0)))
    return result


def threshold_of(change, threshold=None, floor=1.0) -> float:
    """The mean change of all edges where no threshold is given, and the floor at least."""
    return max(np.mean(list(change.values())) if threshold is None else threshold, floor)


def features(points, faces, vertex_count, threshold=None, floor=1.0):
    """(label (V,), weight (V,)): components of edges above the threshold; border edges connect."""
    change = dihedral_changes(points, faces)
    threshold = threshold_of(change, threshold, floor)
    count = {edge: len(sides) for edge, sides in edge_opposites(faces).items()}
    linked = np.array([e for e, c in change.items() if c > threshold or count[e] == 1]).reshape(-1, 2)
    graph = coo_matrix((np.ones(len(linked)), (linked[:, 0], linked[:, 1])), shape=(vertex_count, vertex_count))
    component = connected_components(graph, directed=False)[1]
    label, weight = np.full(vertex_count, -1), np.ones(vertex_count)
    inside = np.unique(linked)
    numbers = {}
    for v in inside:
        label[v] = numbers.setdefault(component[v], len(numbers))
        weight[v] = (component == component[v]).sum()
    return label, weight


def feature_weights(points, faces, vertex_count, method):
    """(V,): the root or one plus the logarithm of the size, or the mean change of the edges in thresholds."""
    size = features(points, faces, vertex_count)[1]
    if method != "bend":
        return {"root": np.sqrt, "log": lambda n: 1 + np.log(n)}[method](size)
    change = dihedral_changes(points, faces)
    threshold = threshold_of(change)
    at = [[c / threshold for e, c in change.items() if v in e and c > threshold] for v in range(vertex_count)]
    return np.array([np.mean(shares) if shares else 1.0 for shares in at])


def length_deformation(points, faces, u, v) -> float:
    """``xi = w A (mean dl)^2`` of edge ``u v``."""
    x = np.asarray(points, dtype=np.float64)
    steps = np.abs(np.diff(np.linalg.norm(x[:, v] - x[:, u], axis=1)))
    if len(steps) == 0:
        return 0.0
    area = sum(
        0.5 * np.linalg.norm(np.cross(x[:, b] - x[:, a], x[:, c] - x[:, a]), axis=1).sum()
        for a, b, c in edge_opposites(faces)[min(u, v), max(u, v)]
    )
    deviation = steps.std()
    weight = (steps.max() - steps.mean()) / deviation if deviation > 1e-7 else 1.0
    return float(weight * area * steps.mean() ** 2)
