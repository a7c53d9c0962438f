"""Small meshes and small animations of them for the tests: points (V, 3) or (F, V, 3) float32, faces (N, 3) int32."""

import numpy as np
import trimesh

Mesh = tuple[np.ndarray, np.ndarray]


def _mesh(points, faces) -> Mesh:
    return np.asarray(points, dtype=np.float32), np.asarray(faces, dtype=np.int32)


def triangle() -> Mesh:
    return _mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])


def tetrahedron() -> Mesh:
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    return _mesh(points, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def octahedron() -> Mesh:
    points = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
    upper = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4]]
    lower = [[2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    return _mesh(points, upper + lower)


def icosphere(subdivisions: int = 2) -> Mesh:
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.5)
    return _mesh(sphere.vertices, sphere.faces)


def torus(major_sections: int = 24, minor_sections: int = 12) -> Mesh:
    mesh = trimesh.creation.torus(0.4, 0.15, major_sections=major_sections, minor_sections=minor_sections)
    return _mesh(mesh.vertices, mesh.faces)


def grid(columns: int, rows: int) -> Mesh:
    """``columns`` x ``rows`` unit squares in the plane z = 0, scaled to a longest side of 1; border all around."""
    x, y = np.meshgrid(np.arange(columns + 1), np.arange(rows + 1))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) / max(columns, rows)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    right, above = corner + 1, corner + columns + 1
    lower = np.stack([corner, right, above], axis=1)
    upper = np.stack([right, above + 1, above], axis=1)
    return _mesh(points, np.stack([lower, upper], axis=1).reshape(-1, 3))


def perforated_plate(holes: int = 3) -> Mesh:
    """A closed plate of side 1 with ``holes`` x ``holes`` square holes through it."""
    cells = 4 * holes + 1
    points, faces = grid(cells, cells)
    middle = points[faces].mean(axis=1)[:, :2] * cells
    # Each hole is three cells wide, one from the next.
    solid = (np.floor(middle).astype(int) % 4 == 0).any(axis=1)
    used, corner = np.unique(faces[solid], return_inverse=True)
    upper, front = points[used], corner.reshape(-1, 3)
    edges = np.concatenate([front[:, [0, 1]], front[:, [1, 2]], front[:, [2, 0]]])
    paired = {(int(b), int(a)) for a, b in edges}
    a, b = np.array([edge for edge in edges.tolist() if tuple(edge) not in paired]).T
    count = len(upper)
    walls = np.concatenate([np.stack([b, a, a + count], axis=1), np.stack([b, a + count, b + count], axis=1)])
    lower = upper - np.array([0, 0, 0.05], dtype=np.float32)
    return _mesh(np.concatenate([upper, lower]), np.concatenate([front, front[:, ::-1] + count, walls]))


def tube(around: int, along: int, length: float = 1.0, radius: float = 0.15) -> Mesh:
    """An open cylinder along x: ``around`` vertices in each of ``along`` + 1 rings."""
    ring, step = np.divmod(np.arange(around * (along + 1)), around)
    angle = 2 * np.pi * step / around
    points = np.stack([length * ring / along, radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    i, j = np.divmod(np.arange(around * along), around)
    a, b = i * around + j, i * around + (j + 1) % around
    c, d = a + around, b + around
    return _mesh(points, np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)]))


def fan(spokes: int, height: float = 0.0) -> Mesh:
    """An open cone: vertex 0 in the middle, at the given height over a ring of ``spokes`` vertices."""
    angle = 2 * np.pi * np.arange(spokes) / spokes
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(spokes)], axis=1) / 2
    i = np.arange(spokes)
    faces = np.stack([np.zeros(spokes, int), 1 + i, 1 + (i + 1) % spokes], axis=1)
    return _mesh(np.concatenate([[[0, 0, height]], ring]), faces)


def joined(*meshes: Mesh, spacing: float = 0.0) -> Mesh:
    """Several meshes as one, each moved by ``spacing`` along x from the one before, without shared vertices."""
    offset = np.cumsum([0] + [len(points) for points, _ in meshes])
    points = [p + np.array([i * spacing, 0, 0], dtype=np.float32) for i, (p, _) in enumerate(meshes)]
    return _mesh(np.concatenate(points), np.concatenate([f + o for (_, f), o in zip(meshes, offset, strict=False)]))


def welded(mesh: Mesh, pairs: dict[int, int]) -> Mesh:
    """The mesh with some vertices replaced by others; the replaced ones stay, without a face."""
    points, faces = mesh
    index = np.arange(len(points))
    index[list(pairs)] = list(pairs.values())
    return _mesh(points, index[faces])


def bow_tie() -> Mesh:
    """Two triangles that share vertex 0 only."""
    return _mesh([[0, 0, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 0]], [[0, 1, 2], [0, 3, 4]])


def double_cone(spokes: int = 8) -> Mesh:
    """Two open cones that share their tip, vertex 0."""
    points, faces = fan(spokes, 0.0)
    up = points + np.array([0, 0, 0.5], dtype=np.float32) * (np.arange(len(points)) > 0)[:, None]
    down = up * np.array([1, 1, -1], dtype=np.float32)
    return welded(joined((up, faces), (down, faces[:, ::-1])), {len(points): 0})


def book(pages: int = 3, size: int = 6) -> Mesh:
    """Grids that share one side: every edge of the spine has as many faces as there are pages."""
    flat, faces = grid(size, size)
    spine = np.flatnonzero(flat[:, 0] == 0)
    leaves, pairs = [], {}
    for page in range(pages):
        angle = 2 * np.pi * page / pages
        leaf = np.stack([flat[:, 0] * np.cos(angle), flat[:, 1], flat[:, 0] * np.sin(angle)], axis=1)
        leaves.append(_mesh(leaf, faces))
        if page:
            pairs.update({int(v) + page * len(flat): int(v) for v in spine})
    return welded(joined(*leaves), pairs)


def moebius(segments: int = 24) -> Mesh:
    """A strip of two squares' width with half a twist: no consistent orientation exists."""
    i, side = np.divmod(np.arange(3 * segments), 3)
    angle, across = 2 * np.pi * i / segments, (side - 1) * 0.15
    radius = 0.5 + across * np.cos(angle / 2)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), across * np.sin(angle / 2)], axis=1)
    faces = []
    for s in range(segments):
        for k in range(2):
            a, b = 3 * s + k, 3 * s + k + 1
            c, d = (a + 3, b + 3) if s + 1 < segments else (2 - k, 1 - k)
            faces += [[a, b, c], [b, d, c]]
    return _mesh(points, faces)


def klein_bottle(around: int = 48, across: int = 16) -> Mesh:
    """A figure of eight that makes half a turn on its way around: closed, and without a consistent orientation."""
    i, j = np.divmod(np.arange(around * across), across)
    u, v = 2 * np.pi * i / around, 2 * np.pi * j / across
    radius = 3 + np.cos(u / 2) * np.sin(v) - np.sin(u / 2) * np.sin(2 * v)
    height = np.sin(u / 2) * np.sin(v) + np.cos(u / 2) * np.sin(2 * v)
    points = np.stack([radius * np.cos(u), radius * np.sin(u), height], axis=1)
    aside = i * across + (j + 1) % across
    further = np.where(i + 1 < around, (i + 1) * across + j, -j % across)
    both = np.where(i + 1 < around, (i + 1) * across + (j + 1) % across, -(j + 1) % across)
    here = np.arange(len(points))
    return _mesh(points, np.concatenate([np.stack([here, aside, both], 1), np.stack([here, both, further], 1)]))


def back_to_back() -> Mesh:
    """Two triangles over the same three vertices, facing apart: a closed surface without volume."""
    return _mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 1]])


def split_faces(mesh: Mesh) -> Mesh:
    """Every face divided into three at its centroid; the new vertices come last and have three faces each."""
    points, faces = mesh
    centre = len(points) + np.arange(len(faces))
    parts = [np.stack([faces[:, k], faces[:, (k + 1) % 3], centre], axis=1) for k in range(3)]
    return _mesh(np.concatenate([points, points[faces].mean(axis=1)]), np.concatenate(parts))


def soup(mesh: Mesh) -> Mesh:
    """Every face with its own three vertices."""
    points, faces = mesh
    return _mesh(points[faces.ravel()], np.arange(faces.size).reshape(-1, 3))


def bumpy_sphere(subdivisions: int = 3) -> Mesh:
    points, faces = icosphere(subdivisions)
    bump = 1 + 0.12 * np.sin(11 * points[:, 0]) * np.cos(9 * points[:, 1] + 5 * points[:, 2])
    return _mesh(points * bump[:, None], faces)


def rotation(axis, angle: float) -> np.ndarray:
    """(3, 3) float64, Rodrigues' formula."""
    x, y, z = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def rigid_motion(points: np.ndarray, frames: int = 6) -> np.ndarray:
    """The same shape turned and moved from frame to frame."""
    moved = [points @ rotation([1, 2, 3], 0.4 * t).T + 0.3 * t * np.array([1.0, -0.5, 0.2]) for t in range(frames)]
    return np.asarray(moved, dtype=np.float32)


def bend(points: np.ndarray, frames: int = 8, most: float = 2.0) -> np.ndarray:
    """Bend about the middle third of the x axis, from straight to ``most`` radians: the outer thirds stay rigid."""
    x, y, z = points.astype(np.float64).T
    low, high = x.min() + np.ptp(x) / 3, x.max() - np.ptp(x) / 3
    result = []
    for angle in np.linspace(0, most, frames):
        curvature = angle / (high - low)
        turn = curvature * (np.clip(x, low, high) - low)
        if angle == 0:
            result.append(points)
            continue
        spine_x = low + np.sin(turn) / curvature + np.cos(turn) * np.maximum(x - high, 0) + np.minimum(x - low, 0)
        spine_z = (1 - np.cos(turn)) / curvature + np.sin(turn) * np.maximum(x - high, 0)
        result.append(np.stack([spine_x - z * np.sin(turn), y, spine_z + z * np.cos(turn)], axis=1))
    return np.asarray(result, dtype=np.float32)


def bending_bar(around: int = 16, along: int = 40, frames: int = 8) -> Mesh:
    points, faces = tube(around, along)
    return bend(points, frames), faces


def waving_grid(size: int = 20, frames: int = 8) -> Mesh:
    points, faces = grid(size, size)
    t = np.arange(frames)[:, None] / frames
    wave = np.repeat(points[None], frames, axis=0)
    wave[:, :, 2] = 0.1 * np.sin(2 * np.pi * (1.5 * points[:, 0] + t)) * np.cos(4 * points[:, 1] - 2 * t)
    return wave, faces


def swaying_sphere(subdivisions: int = 3, frames: int = 8) -> Mesh:
    """A bumpy sphere that twists and swells: closed, no two frames congruent."""
    points, faces = bumpy_sphere(subdivisions)
    moved = []
    for t in np.linspace(0, 1, frames):
        turn = 1.2 * t * points[:, 2]
        x = points[:, 0] * np.cos(turn) - points[:, 1] * np.sin(turn)
        y = points[:, 0] * np.sin(turn) + points[:, 1] * np.cos(turn)
        z = points[:, 2] * (1 + 0.3 * t * np.sin(3 * points[:, 0]))
        moved.append(np.stack([x, y, z], axis=1))
    return np.asarray(moved, dtype=np.float32), faces


def shape_quality(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return 4 sqrt(3) area / sum of squared edge lengths: 1 for equilateral triangles, 0 for degenerate ones."""
    corner = points[faces].astype(float)
    length_squared = ((corner - np.roll(corner, 1, axis=1)) ** 2).sum(axis=(1, 2))
    double_area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    return 2.0 * np.sqrt(3.0) * double_area / length_squared
