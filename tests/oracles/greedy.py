"""Serial greedy deformation sensitive decimation: one heap, per-frame optima, the yardstick of quality."""

import heapq

import numpy as np

from tests.oracles.quadrics import pack, vertex_quadrics


def _stacked(points, faces):
    """Quadrics of all vertices in all frames about the world's origin: A (V, F, 3, 3), b (V, F, 3), c (V, F)."""
    packed = np.array(
        [[pack(q) for q in vertex_quadrics(x, faces, origin=np.zeros_like(x))] for x in points.astype(np.float64)]
    ).transpose(1, 0, 2)
    order = [0, 1, 2, 1, 3, 4, 2, 4, 5]
    return packed[..., order].reshape(*packed.shape[:2], 3, 3), packed[..., 6:9], packed[..., 9]


class GreedySimplifier:
    """Collapses the cheapest legal edge until the target is met."""

    def __init__(self, points, faces):
        self.x = points.astype(np.float64).transpose(1, 0, 2).copy()
        self.A, self.b, self.c = _stacked(points, faces)
        self.faces = [tuple(f) for f in faces.tolist()]
        self.faces_of = [set() for _ in range(points.shape[1])]
        for i, f in enumerate(self.faces):
            for v in f:
                self.faces_of[v].add(i)
        self.alive = len(self.faces)
        self.version = [0] * points.shape[1]
        self.heap = []

    def ring(self, v):
        return {w for i in self.faces_of[v] for w in self.faces[i]} - {v}

    def on_border(self, v):
        return len(self.ring(v)) != len(self.faces_of[v])

    def best(self, u, v):
        A, b, c = self.A[u] + self.A[v], self.b[u] + self.b[v], self.c[u] + self.c[v]
        middle = (self.x[u] + self.x[v]) / 2
        # A weak regularisation towards the edge's middle keeps flat one-rings solvable.
        soft = 1e-3 * np.trace(A, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        x = np.linalg.solve(A + soft, (np.einsum("tij,tj->ti", soft, middle) - b)[..., None])[..., 0]
        cost = np.einsum("ti,tij,tj->", x, A, x) + 2 * (b * x).sum() + c.sum()
        return max(cost, 0.0), x

    def push(self, u, v):
        cost, x = self.best(u, v)
        heapq.heappush(self.heap, (cost, u, v, self.version[u], self.version[v], x.tobytes()))

    def is_legal(self, u, v, x):
        shared = self.faces_of[u] & self.faces_of[v]
        opposites = {w for i in shared for w in self.faces[i]} - {u, v}
        if self.ring(u) & self.ring(v) != opposites or (len(shared) == 2 and self.on_border(u) and self.on_border(v)):
            return False
        if any(len(self.faces_of[w]) <= (1 if self.on_border(w) else 3) for w in opposites):
            return False
        for i in (self.faces_of[u] | self.faces_of[v]) - shared:
            old = self.x[list(self.faces[i])]
            new = np.stack([x if w in (u, v) else self.x[w] for w in self.faces[i]])
            n, m = (np.cross(y[1] - y[0], y[2] - y[0]) for y in (old, new))
            if ((n * m).sum(axis=1) <= 0.2 * np.linalg.norm(n, axis=1) * np.linalg.norm(m, axis=1)).any():
                return False
        return True

    def collapse(self, u, v, x):
        for i in self.faces_of[u] & self.faces_of[v]:
            for w in self.faces[i]:
                self.faces_of[w].discard(i)
            self.alive -= 1
        for i in self.faces_of[v]:
            self.faces[i] = tuple(u if w == v else w for w in self.faces[i])
        self.faces_of[u] |= self.faces_of[v]
        self.faces_of[v] = set()
        self.x[u] = x
        self.A[u] += self.A[v]
        self.b[u] += self.b[v]
        self.c[u] += self.c[v]
        self.version[u] += 1
        self.version[v] += 1
        for w in self.ring(u):
            self.push(min(u, w), max(u, w))

    def run(self, target):
        """(points (F, V', 3), faces (N', 3)) at the target."""
        for f in self.faces:
            for k in range(3):
                u, v = f[k], f[(k + 1) % 3]
                if u < v or u not in self.ring(v):
                    self.push(min(u, v), max(u, v))
        while self.alive > target and self.heap:
            _, u, v, version_u, version_v, packed = heapq.heappop(self.heap)
            if (version_u, version_v) != (self.version[u], self.version[v]):
                continue
            x = np.frombuffer(packed).reshape(-1, 3)
            if self.is_legal(u, v, x):
                self.collapse(u, v, x)
        live = sorted({i for around in self.faces_of for i in around})
        used, faces = np.unique([self.faces[i] for i in live], return_inverse=True)
        return self.x[used].transpose(1, 0, 2), faces.reshape(-1, 3)


def greedy_simplify(points, faces, target):
    return GreedySimplifier(points, faces).run(target)
