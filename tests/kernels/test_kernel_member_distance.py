"""Distances of merged input vertices from the faces that a collapse leaves, and what follows from them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import trimesh
import warp as wp

import warpqem
from tests.oracles import topology as oracle
from tests.support import meshes
from tests.support.mesh_state import build_mesh, cost_model, edge_list, half_edge_between, one_part, packed
from warpqem.kernels.lanes import width_of
from warpqem.kernels.legality import GAP_COST, check_collapses
from warpqem.measure import compare

FAR = 1e30


class CheckedCollapse:
    """One edge whose collapse to ``target`` (3,) is checked: faces removed, error, and the cost it has then."""

    def __init__(self, points, faces, edge, target, device, cost=FAR, chains=(), **model):
        mesh = build_mesh(points, faces, device)
        for first, second in chains:
            following, last = (a.numpy().copy() for a in (mesh.state.members.following, mesh.state.members.last))
            following[first], last[first] = second, second
            mesh.state.members.following.assign(following)
            mesh.state.members.last.assign(last)
        half_edge = half_edge_between(faces, *edge)
        mesh.state.edge_cost.fill_(cost)
        blocks = packed(np.asarray(target, dtype=np.float32).reshape(1, 1, 3), device)
        removed, legal, space = (wp.zeros(1, dtype=wp.int32, device=device) for _ in range(3))
        error = wp.zeros(1, dtype=wp.float32, device=device)
        selected = edge_list([half_edge], device)
        inputs = [mesh.state, mesh.frames, cost_model(**model), selected, blocks, 0, one_part(device)]
        outputs = [removed, error, legal, space]
        wp.launch(check_collapses[width_of(blocks)], dim=1, inputs=inputs, outputs=outputs, device=device)
        self.removed, self.error = int(removed.numpy()[0]), float(error.numpy()[0])
        self.cost = float(mesh.state.edge_cost.numpy()[half_edge])
        self.area = mesh.state.members.area.numpy()[0].astype(np.float64)


def expected_gap(points, faces, edge, target, members):
    """Squared distances (M,) of members from the faces around the edge once both ends are at the target."""
    moved = points.astype(np.float64).copy()
    moved[list(edge)] = target
    left = oracle.collapsed(faces, *edge)
    around = left[np.isin(left, edge).any(axis=1)]
    squares = []
    for query in points[members].astype(np.float64):
        nearest = trimesh.triangles.closest_point(moved[around], np.tile(query, (len(around), 1)))
        squares.append(((nearest - query) ** 2).sum(axis=1).min())
    return np.array(squares)


@pytest.mark.parametrize("along", [0.0, 0.3, 1.0])
def test_error_is_the_mean_squared_distance_of_both_ends(along, device):
    points, faces = meshes.bumpy_sphere(2)
    points = points.astype(np.float32)
    u, v = faces[10, :2].tolist()
    target = points[u] + along * (points[v] - points[u])
    checked = CheckedCollapse(points, faces, (u, v), target, device)
    area = checked.area[[u, v]]
    expected = (area * expected_gap(points, faces, (u, v), target, [u, v])).sum() / area.sum()
    assert checked.removed == 2
    assert checked.error == pytest.approx(expected, rel=1e-3, abs=1e-12)


def test_members_that_were_merged_before_count_too(device):
    points, faces = meshes.bumpy_sphere(2)
    points = points.astype(np.float32)
    u, v = faces[10, :2].tolist()
    third = int(np.argmax(np.linalg.norm(points - points[u], axis=1)))
    target = 0.5 * (points[u] + points[v])
    checked = CheckedCollapse(points, faces, (u, v), target, device, chains=[(v, third)])
    members = [u, v, third]
    area = checked.area[members]
    expected = (area * expected_gap(points, faces, (u, v), target, members)).sum() / area.sum()
    assert checked.error == pytest.approx(expected, rel=1e-3)
    assert expected > 100 * CheckedCollapse(points, faces, (u, v), target, device).error


@pytest.mark.parametrize("count", [3, 8, 9, 16, 21])
def test_members_are_all_looked_at_however_many_there_are(count, device):
    # Eight are looked at side by side.
    points, faces = meshes.bumpy_sphere(2)
    points = points.astype(np.float32)
    u, v = faces[10, :2].tolist()
    others = [int(m) for m in np.random.default_rng(count).permutation(len(points)) if m not in (u, v)][: count - 2]
    of_u = [u, *others[: len(others) // 3]]
    of_v = [v, *others[len(others) // 3 :]]
    chains = [pair for members in (of_u, of_v) for pair in pairwise(members)]
    target = 0.3 * points[u] + 0.7 * points[v]
    checked = CheckedCollapse(points, faces, (u, v), target, device, chains=chains)
    members = [*of_u, *of_v]
    area = checked.area[members]
    expected = (area * expected_gap(points, faces, (u, v), target, members)).sum() / area.sum()
    assert checked.error == pytest.approx(expected, rel=1e-4)


def test_collapse_that_is_costlier_by_distance_is_put_off_at_its_new_cost(device):
    points, faces = meshes.bumpy_sphere(2)
    points = points.astype(np.float32)
    u, v = faces[10, :2].tolist()
    target = points[u]
    checked = CheckedCollapse(points, faces, (u, v), target, device, cost=1e-12, key_count=3)
    area = checked.area[[u, v]].sum()
    assert checked.removed == 0
    assert checked.cost == pytest.approx(3 * float(GAP_COST) * checked.error * area, rel=1e-4)
    assert CheckedCollapse(points, faces, (u, v), target, device, cost=checked.cost, key_count=3).removed == 2


def test_collapse_beyond_the_error_limit_has_an_infinite_cost(device):
    points, faces = meshes.bumpy_sphere(2)
    points = points.astype(np.float32)
    u, v = faces[10, :2].tolist()
    error = CheckedCollapse(points, faces, (u, v), points[u], device).error
    assert CheckedCollapse(points, faces, (u, v), points[u], device, error_limit=1.01 * error).removed == 2
    beyond = CheckedCollapse(points, faces, (u, v), points[u], device, error_limit=0.99 * error)
    assert (beyond.removed, beyond.cost) == (0, np.inf)


@pytest.mark.parametrize("memoryless", [False, True])
def test_thin_blade_keeps_its_tip(memoryless, device):
    # Out of a sphere grows a blade, thirty times as long as thick at its tip. Planes alone take 7.8 % of it away.
    points, faces = meshes.icosphere(4)
    height = np.abs(points[:, 2]).max()
    outward = np.clip((points[:, 2] / height - 0.8) / 0.2, 0, None)
    points[:, 2] += 4 * height * outward**1.5
    points[:, :2] *= 1 - np.array([0.97, 0.9]) * outward[:, None] ** 0.5
    result = warpqem.simplify(points, faces, ratio=0.05, memoryless=memoryless, device=device)
    distance = compare(points[None], faces, result.points, result.faces, samples=20000, device=device)
    assert distance.hausdorff < 3.0


@pytest.mark.parametrize("quality", ["fast", "best"])
@pytest.mark.parametrize(
    "growth", [[0, 0, 1, 1], [0, 0, 0, 0, 0, 1, 1, 1], [0] * 8 + [1] * 8], ids=["half", "late", "many"]
)
def test_what_grows_out_of_the_surface_after_the_first_frame_keeps_its_tip(growth, quality, device):
    # With distances in the first frame alone the blade lost 3 to 6 % of the diagonal.
    points, faces = meshes.icosphere(4)
    height = np.abs(points[:, 2]).max()
    outward = np.clip((points[:, 2] / height - 0.8) / 0.2, 0, None)
    grown = points.copy()
    grown[:, 2] += 4 * height * outward**1.5
    grown[:, :2] *= 1 - np.array([0.97, 0.9]) * outward[:, None] ** 0.5
    frames = np.stack([points + share * (grown - points) for share in growth]).astype(np.float32)
    result = warpqem.simplify(frames, faces, ratio=0.05, quality=quality, measure=False, device=device)
    distance = compare(frames, faces, result.points, result.faces, samples=20000, device=device)
    assert distance.hausdorff < 1.5


@pytest.mark.parametrize("quality", ["fast", "best"])
@pytest.mark.parametrize("smallest", [0.0, 0.001, 0.01, 0.1])
def test_mesh_that_grows_as_a_whole_reaches_its_goal(smallest, quality, device):
    points, faces = meshes.bumpy_sphere(3)
    frames = np.stack([share * points for share in np.linspace(smallest, 1, 10)]).astype(np.float32)
    result = warpqem.simplify(frames, faces, ratio=0.1, quality=quality, measure=False, device=device)
    assert len(result.faces) == len(faces) // 10
    alone = warpqem.simplify(points[None], faces, ratio=0.1, quality=quality, measure=False, device=device)
    distances = [
        compare(points[None], faces, each[-1:], mesh.faces, samples=20000, device=device).hausdorff
        for each, mesh in ((result.points, result), (alone.points, alone))
    ]
    assert distances[0] < 1.5 * distances[1]
