"""E(v, a) of a merged vertex against the formula of the paper."""

import numpy as np
import pytest
import warp as wp
from pxr import Usd, UsdGeom

from benchmarks import articulated, skin_order
from benchmarks.settings import Settings
from benchmarks.skin_collapse import collapse_edges, squared_distances
from benchmarks.skin_order import JointOrder, PoseOrder
from tests.oracles import articulated as oracle
from tests.support.meshes import rotation, tube
from warpqem.kernels.skin_fit import REACH
from warpqem.measure import topology
from warpqem.skinning.fit_problem import SURFACE_REGULARISATION, CandidateRows, ClusterPlanes, SkinFit
from warpqem.skinning.linear_skin import LinearSkin, pose_skin
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses

POSES, JOINTS = 5, 4


def skinned_tube():
    """A dented tube, its skin and transforms (P, J, 3, 4), the first of them the rest shape."""
    points, faces = tube(8, 12)
    points[:, 1:] *= 1 + 0.05 * np.sin(20 * points[:, :1])
    points /= np.linalg.norm(np.ptp(points, axis=0))
    rng = np.random.default_rng(1)
    transforms = np.broadcast_to(np.eye(4)[:3], (POSES, JOINTS, 3, 4)).copy()
    for pose in range(1, POSES):
        for joint in range(JOINTS):
            transforms[pose, joint, :, :3] = rotation(rng.normal(size=3), rng.uniform(-0.5, 0.5))
            transforms[pose, joint, :, 3] = rng.normal(scale=0.05, size=3)
    joints = np.tile(np.arange(JOINTS, dtype=np.int32), (len(points), 1))
    weights = np.exp(-(((points[:, :1] - np.linspace(*points[[0, -1], 0], JOINTS)) / 0.3) ** 2))
    weights /= weights.sum(axis=1, keepdims=True)
    return LinearSkin(points.astype(np.float64), joints, weights), faces, transforms


SKIN, FACES, TRANSFORMS = skinned_tube()
# What the planes of borders add is not in the formula.
INNER = np.flatnonzero(np.bincount(FACES.ravel()) == 6)


def inner_edges():
    ends = np.unique(np.sort(np.concatenate([FACES[:, [0, 1]], FACES[:, [1, 2]], FACES[:, [2, 0]]]), axis=1), axis=0)
    return ends[np.isin(ends, INNER).all(axis=1)]


def quadrics(vertices, poses):
    return np.stack([oracle.plane_quadric(pose, FACES, vertices) for pose in poses])


def test_fit_of_a_merged_vertex_minimises_the_formula(device):
    # (p - y)^T H (p - y) is p^T Q p and the regularisation towards where the vertex was placed, up to a constant.
    poses = pose_skin(SKIN, TRANSFORMS).astype(np.float32)
    checked = 0
    for u, v in inner_edges()[::11].tolist():
        cluster = np.arange(len(SKIN.rest), dtype=np.int32)
        cluster[v] = u
        rest, weights = 0.5 * (SKIN.rest[u] + SKIN.rest[v]), 0.5 * (SKIN.weights[u] + SKIN.weights[v])
        placed = oracle.skinned(TRANSFORMS, rest, weights)[:, :3]
        planes = ClusterPlanes(FACES, cluster, len(cluster), None, device)
        given = wp.array(poses, dtype=wp.vec3, device=device)
        stiffness, goal = planes.gather(slice(u, u + 1), given, placed[:, None], True)
        Q = quadrics([u, v], poses)
        trace = np.trace(Q[:, :3, :3], axis1=1, axis2=2)
        away = np.linalg.norm(goal.numpy()[:, 0] - placed, axis=1)
        if (away > 0.99 * float(REACH) * np.sqrt(trace / (3 * np.pi))).any():
            continue
        rows = CandidateRows(np.array([0, JOINTS]), np.arange(JOINTS), weights)
        fit = SkinFit(TRANSFORMS, rows, rest[None], placed[:, None], None, 1.0, device)
        fitted, weight, before, after = fit._solve_batch(slice(0, 1), stiffness, goal, JOINTS)
        moved = oracle.skinned(TRANSFORMS, fitted[0], weight)[:, :3]
        soft = SURFACE_REGULARISATION * (trace * ((moved - placed) ** 2).sum(axis=1)).sum()
        lower = oracle.energy(Q, TRANSFORMS, fitted[0], weight) + soft
        assert before[0] - after[0] == pytest.approx(oracle.energy(Q, TRANSFORMS, rest, weights) - lower, rel=1e-4)
        assert after[0] < before[0]
        checked += 1
    assert checked > 5


@pytest.fixture
def order(device, monkeypatch):
    monkeypatch.setattr(skin_order, "LENGTH_COST", 0.0)
    return JointOrder(SKIN, TRANSFORMS, FACES, JOINTS, device)


def test_cost_of_an_edge_is_the_formula_at_the_merged_vertex(order):
    ends = inner_edges()
    merged = order.merged(*ends.T)
    poses = pose_skin(SKIN, TRANSFORMS)
    for pair, cost, rest, weights in zip(ends, merged["cost"], merged["rest"], merged["weights"], strict=True):
        assert cost == pytest.approx(oracle.energy(quadrics(pair, poses), TRANSFORMS, rest, weights), rel=1e-8)
        assert (weights >= 0).all()
        assert weights.sum() == pytest.approx(1)


def test_merged_vertex_keeps_its_skin_and_the_planes_of_all_it_stands_for(order):
    u, v = inner_edges()[10]
    w = next(x for x in np.setdiff1d(INNER, [u, v]) if np.isin(FACES, [u, x]).sum(axis=1).max() == 2)
    row = {name: values[0] for name, values in order.merged(np.array([u]), np.array([v])).items()}
    order.commit(u, v, row)
    np.testing.assert_array_equal(order.rest[u], row["rest"])
    np.testing.assert_allclose(
        order.posed[u], oracle.skinned(TRANSFORMS, row["rest"], row["weights"])[:, :3], atol=1e-12
    )
    merged = order.merged(np.array([u]), np.array([w]))
    Q = quadrics([u, v, w], pose_skin(SKIN, TRANSFORMS))
    expected = oracle.energy(Q, TRANSFORMS, merged["rest"][0], merged["weights"][0])
    assert merged["cost"][0] == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("memoryless", [False, True])
@pytest.mark.parametrize("kind", ["joint", "poses"])
def test_collapses_keep_a_manifold_and_meet_the_targets(kind, memoryless):
    if kind == "joint":
        order = JointOrder(SKIN, TRANSFORMS, FACES, 2, "cpu", memoryless)
    else:
        order = PoseOrder(pose_skin(SKIN, TRANSFORMS), FACES, memoryless)
    for target, left in zip((100, 60), collapse_edges(order, FACES, [100, 60]), strict=True):
        assert target - 1 <= len(left.faces) <= target
        found, was = topology(left.faces), topology(FACES)
        assert (found.non_manifold_edges, found.euler_number) == (0, was.euler_number)
        np.testing.assert_array_equal(np.sort(left.vertex_map[FACES[left.face_map]]), np.sort(left.faces))
        assert (left.vertex_map[left.vertex] == np.arange(len(left.vertex))).all()
    if kind == "joint":
        assert ((order.weights[left.vertex] > 0).sum(axis=1)[np.bincount(left.vertex_map) > 1] <= 2).all()


def test_distances_from_triangles_are_those_of_a_dense_sampling():
    rng = np.random.default_rng(2)
    points, triangles = rng.normal(size=(20, 3)), rng.normal(size=(4, 3, 3))
    a, b = np.meshgrid(np.linspace(0, 1, 200), np.linspace(0, 1, 200))
    a, b = a[a + b <= 1], b[a + b <= 1]
    samples = np.stack([1 - a - b, a, b], axis=1) @ triangles
    nearest = ((points[:, None, None] - samples) ** 2).sum(axis=3).min(axis=2)
    np.testing.assert_allclose(squared_distances(points, triangles), nearest, atol=0.02)
    assert (squared_distances(points, triangles) <= nearest + 1e-12).all()


def test_benchmark_measures_every_order_on_unseen_poses(tmp_path, monkeypatch):
    chain = np.arange(-1, TRANSFORMS.shape[1] - 1)
    clip = articulated.SkinnedClip(SKIN, FACES, TRANSFORMS, parents=chain, offsets=None)
    monkeypatch.setattr(articulated, "read_clip", lambda path, prim: clip)
    monkeypatch.setattr(articulated, "QUICK_RATIOS", (0.4,))
    [table] = articulated.run(Settings(tmp_path, quick=True, device="cpu")).tables
    assert [row["order"] for row in table.rows] == ["warpqem", "poses", "E(v, a)"] * 2
    for row in table.rows:
        assert 0 <= int(0.4 * len(FACES)) - row["faces"] <= 1
        assert ("own" in row) == (row["order"] == "E(v, a)")
        assert all(0.0 < row[name] < 10.0 for name in ("fit", "refit", "own") if name in row)


def test_clip_of_a_file_has_the_poses_of_its_stage():
    clip = articulated.read_clip(articulated.SCENE)
    assert np.linalg.norm(np.ptp(clip.skin.rest, axis=0)) == pytest.approx(1.0)
    stage = Usd.Stage.Open(str(articulated.SCENE))
    [mesh] = (prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
    source = MeshSource(mesh, StagePoses(stage))
    used = np.unique(source.topology.triangles)
    expected = np.stack([source.points_at(time)[used] for time in (1.0, 20.0)])
    poses = clip.poses(clip.transforms[[0, 19]])
    poses *= np.linalg.norm(np.ptp(expected[0], axis=0)) / np.linalg.norm(np.ptp(poses[0], axis=0))
    np.testing.assert_allclose(poses, expected, atol=1e-4)
