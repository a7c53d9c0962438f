"""Committing collapses, and closing the gaps between live faces."""

import numpy as np
import pytest
import warp as wp

from tests.oracles import quadrics as quadric_oracle
from tests.oracles import topology as oracle
from tests.support import meshes
from tests.support.mesh_state import (
    blocks,
    build_mesh,
    collapse_log,
    cost_model,
    edge_list,
    half_edge_between,
    one_part,
    packed_quadrics,
)
from warpqem.decimation.adjacency import build_adjacency
from warpqem.kernels.collapse import commit_collapses, mark_live_faces, move_live_faces, open_log, remove_dead_corners
from warpqem.kernels.deformation import move_trajectories
from warpqem.kernels.lanes import width_of
from warpqem.kernels.legality import place_collapses
from warpqem.kernels.topology import CORNER, SEAM

MESHES = {"closed": meshes.swaying_sphere(1, 3), "open": meshes.bending_bar(6, 5, 4)}
PASS = 7
RIM_EDGE = (1, 0)  # the border half-edge of the open mesh between its vertices 0 and 1


class Commit:
    """One committed edge of a mesh: state, log, mask, target (K, 3) and anchor."""

    def __init__(
        self,
        points,
        faces,
        edge,
        device,
        faces_removed=2,
        seam=None,
        flags=None,
        member_error=0.0,
        kept_sums=None,
        **options,
    ):
        self.faces, self.edge, self.half_edge = faces, edge, half_edge_between(faces, *edge)
        self.mesh = build_mesh(points, faces, device, **options)
        self.state, frames = self.mesh.state, self.mesh.frames
        if seam is not None:
            self.state.seam = wp.array(seam, device=device)
            self.state.vertex_flags = wp.array(self.state.vertex_flags.numpy() | flags, device=device)
        if kept_sums is not None:
            rows = np.full(points.shape[1], -1, dtype=np.int32)
            rows[list(kept_sums)] = np.arange(len(kept_sums))
            self.state.sum_row = wp.array(rows, device=device)
            frames.kept_sum = packed_quadrics(list(kept_sums.values()), frames.position)
        self.before = self.mesh.quadric.astype(np.float64)
        self.state.edge_cost.fill_(3.0)
        selected = edge_list([self.half_edge], device)
        target = wp.empty((1, frames.position.shape[1]), dtype=frames.position.dtype, device=device)
        self.anchor = wp.empty(1, dtype=wp.float32, device=device)
        inputs = [self.state, frames, cost_model(), selected, one_part(device)]
        wp.launch(place_collapses[width_of(target)], dim=1, inputs=inputs, outputs=[target, self.anchor], device=device)
        self.target = blocks(target, len(points))[0]
        self.log = collapse_log(points.shape[1], device)
        self.mask = wp.zeros(points.shape[1], dtype=wp.int32, device=device)
        number, removed = (wp.array([n], dtype=wp.int32, device=device) for n in (PASS, faces_removed))
        legal, slot, pool_slot, space = (
            wp.array([n], dtype=wp.int32, device=device) for n in (int(faces_removed > 0), 0, 0, 20)
        )
        outputs = [legal, space, self.log, slot, self.state.adjacency.used, pool_slot]
        wp.launch(open_log, dim=1, inputs=[], outputs=outputs, device=device)
        self.pool_used = self.state.adjacency.used.numpy()[0]
        error = wp.array([member_error], dtype=wp.float32, device=device)
        inputs = [self.state, frames, selected, removed, target, self.anchor, error, number, one_part(device)]
        outputs = [self.mask, self.log, slot, pool_slot]
        wp.launch(commit_collapses[width_of(target)], dim=1, inputs=inputs, outputs=outputs, device=device)
        self.number = number
        if self.state.trajectory.shape[0]:
            self.move_trajectories(device)

    def move_trajectories(self, device):
        begin = wp.zeros(1, dtype=wp.int32, device=device)
        wp.launch(move_trajectories, dim=1, inputs=[self.state, self.log, begin, one_part(device)], device=device)

    def live_faces(self):
        faces = self.state.corner_vertex.numpy().reshape(-1, 3)
        return faces[faces[:, 0] >= 0]


def seam_flags_after(pairs, corners, device) -> int:
    """SEAM and CORNER of the vertex that the edge 6 7 of a 4 x 4 grid with seams along vertex pairs becomes."""
    points, faces = meshes.grid(4, 4)
    seam = np.zeros(faces.size, dtype=np.int32)
    seam[[half_edge_between(faces, *ends) for u, v in pairs for ends in ((u, v), (v, u))]] = 1
    flags = np.zeros(len(points), dtype=np.int32)
    flags[np.unique(pairs)] |= int(SEAM)
    flags[corners] |= int(CORNER)
    commit = Commit(points[None], faces, (6, 7), device, seam=seam, flags=flags)
    return int(commit.state.vertex_flags.numpy()[6]) & (int(SEAM) | int(CORNER))


@pytest.mark.parametrize(
    ("pairs", "corners", "expected"),
    [
        ([(5, 6), (6, 7), (7, 8)], [], int(SEAM)),  # goes on both ways
        ([(6, 7), (7, 8)], [6], int(SEAM) | int(CORNER)),  # ends here
        ([(6, 7)], [6, 7], 0),  # was no longer than the edge
        ([(1, 6), (6, 11), (2, 7), (7, 12)], [], int(SEAM) | int(CORNER)),  # two cross
    ],
)
def test_merged_vertex_has_the_seam_flags_of_its_seams(pairs, corners, expected, device):
    assert seam_flags_after(pairs, corners, device) == expected


def closed_commit(device, **options):
    points, faces = MESHES["closed"]
    u, v = sorted(faces[0, :2].tolist())
    return Commit(points, faces, (u, v), device, **options)


def test_faces_at_the_edge_die_and_the_others_name_the_kept_vertex(device):
    commit = closed_commit(device)
    np.testing.assert_array_equal(commit.live_faces(), oracle.collapsed(commit.faces, *commit.edge))


def test_adjacency_built_after_a_commit_holds_each_live_corner_once(device):
    commit = closed_commit(device)
    adjacency = build_adjacency(commit.state.corner_vertex, len(commit.mask))
    corners = np.flatnonzero(commit.state.corner_vertex.numpy() >= 0)
    count = adjacency.start.numpy()[-1]
    np.testing.assert_array_equal(np.sort(adjacency.corner.numpy()[:count]), corners)
    assert adjacency.start.numpy()[commit.edge[1]] == adjacency.start.numpy()[commit.edge[1] + 1]


@pytest.mark.parametrize("with_sums", ["kept", "removed", "both", "neither"])
def test_merged_vertex_has_the_sums_of_both_about_where_it_is(with_sums, device):
    points, faces = MESHES["closed"]
    edge = sorted(faces[0, :2].tolist())
    chosen = {"kept": edge[:1], "removed": edge[1:], "both": edge, "neither": []}[with_sums]
    own = np.array([[quadric_oracle.pack(q) for q in quadric_oracle.vertex_quadrics(x, faces)] for x in points])
    # Sums of other vertices are not zero at the vertex.
    sums = {v: own[:, (v + 7) % points.shape[1]] + np.arange(10) * 0.01 for v in [*chosen, 40]}
    commit = closed_commit(device, kept_sums=sums)
    row = commit.state.sum_row.numpy()
    if not chosen:
        assert row[edge[0]] == -1
        return
    found = blocks(commit.mesh.frames.kept_sum, len(points))[row[edge[0]]]
    for frame, x in enumerate(points.astype(np.float64)):
        expected = quadric_oracle.zero()
        for v in chosen:
            quadric = quadric_oracle.unpack(sums[v][frame])
            expected += quadric_oracle.shifted(quadric, commit.target[frame] - x[v])
        np.testing.assert_allclose(found[frame], quadric_oracle.pack(expected), rtol=1e-3, atol=1e-4)
    untouched = blocks(commit.mesh.frames.kept_sum, len(points))[row[40]]
    np.testing.assert_allclose(untouched, sums[40], rtol=1e-6)


def corners_at(lists, v):
    return lists.corner.numpy()[lists.start.numpy()[v] : lists.end.numpy()[v]].tolist()


def check_adjacency(commit, device):
    """The corners of every vertex are those that the faces give, in the same order."""
    adjacency = commit.state.adjacency
    fresh = build_adjacency(commit.state.corner_vertex, len(commit.mask)).lists
    assert [corners_at(adjacency, v) for v in range(len(commit.mask))] == [
        corners_at(fresh, v) for v in range(len(commit.mask))
    ]


def drop(commit, device, part=0, part_count=1, updated=None):
    updated = wp.zeros(len(commit.mask), dtype=wp.int32, device=device) if updated is None else updated
    begin = wp.zeros(1, dtype=wp.int32, device=device)
    inputs = [commit.state, commit.log, begin, commit.number, one_part(device, part, part_count)]
    wp.launch(remove_dead_corners, dim=1, inputs=inputs, outputs=[updated], device=device)


@pytest.mark.parametrize("name", MESHES)
def test_adjacency_kept_up_equals_one_built_anew(name, device):
    points, faces = MESHES[name]
    commit = Commit(points, faces, faces[0, :2].tolist(), device)
    drop(commit, device)
    check_adjacency(commit, device)


def test_two_parts_update_the_adjacency_of_all_opposite_vertices(device):
    commit = closed_commit(device)
    updated = wp.zeros(len(commit.mask), dtype=wp.int32, device=device)
    for part in range(2):
        drop(commit, device, part, 2, updated)
    check_adjacency(commit, device)


def test_new_adjacency_lies_behind_the_old_in_the_pool(device):
    commit = closed_commit(device)
    first = commit.faces.size
    assert commit.state.adjacency.start.numpy()[commit.edge[0]] == first
    assert commit.pool_used == first + 20


def test_adjacency_without_room_in_the_pool_is_left_as_it_was(device):
    points, faces = MESHES["closed"]
    u, v = sorted(faces[0, :2].tolist())
    before = build_mesh(points, faces, device).state.adjacency
    after = Commit(points, faces, (u, v), device, spare=0).state.adjacency
    assert corners_at(after, u) == corners_at(before, u)


def test_dead_faces_have_no_cost(device):
    commit = closed_commit(device)
    dead = commit.state.corner_vertex.numpy() < 0
    cost = commit.state.edge_cost.numpy()
    assert dead.sum() == 6
    assert np.isinf(cost[dead]).all()
    assert np.isfinite(cost[~dead]).all()


def test_kept_vertex_moves_to_the_target(device):
    commit = closed_commit(device)
    np.testing.assert_array_equal(commit.mesh.position[commit.edge[0]], commit.target)


def test_members_of_both_ends_belong_to_the_one_that_is_kept(device):
    commit = closed_commit(device)
    kept, removed = sorted(commit.edge)
    members = commit.state.members
    assert members.following.numpy()[kept] == removed
    assert (members.following.numpy()[removed], members.last.numpy()[kept]) == (-1, removed)


def test_larger_of_both_errors_is_logged(device):
    points, faces = MESHES["closed"]
    small, large = (Commit(points, faces, faces[0, :2].tolist(), device, member_error=e).log for e in (0.0, 0.5))
    assert large.error.numpy()[0] == 0.5
    assert 0 < small.error.numpy()[0] < 0.5


def test_lower_vertex_is_kept_whichever_way_the_half_edge_runs(device):
    points, faces = MESHES["closed"]
    u, v = sorted(faces[0, :2].tolist())
    log = Commit(points, faces, (v, u), device).log
    assert (log.kept.numpy()[0], log.removed.numpy()[0]) == (u, v)


def test_locked_vertex_is_kept_although_it_is_the_higher(device):
    points, faces = MESHES["closed"]
    u, v = sorted(faces[0, :2].tolist())
    log = Commit(points, faces, (u, v), device, locked=[v]).log
    assert (log.kept.numpy()[0], log.removed.numpy()[0]) == (v, u)


@pytest.mark.parametrize("name", MESHES)
def test_quadric_of_the_kept_vertex_is_the_sum_about_its_new_place(name, device):
    points, faces = MESHES[name]
    u, v = (0, 1) if name == "open" else sorted(faces[0, :2].tolist())
    edge = RIM_EDGE if name == "open" else (u, v)
    commit = Commit(points, faces, edge, device, faces_removed=1 if name == "open" else 2)
    after = commit.mesh.quadric[u]
    for t in range(len(points)):
        x = commit.target[t].astype(np.float64)
        ends = [quadric_oracle.shifted(quadric_oracle.unpack(commit.before[w, t]), x - points[t, w]) for w in (u, v)]
        np.testing.assert_allclose(after[t], quadric_oracle.pack(ends[0] + ends[1]), rtol=1e-3, atol=1e-6)


def test_error_is_the_mean_square_over_frames(device):
    commit = closed_commit(device)
    quadrics = [quadric_oracle.unpack(q) for q in commit.mesh.quadric[commit.edge[0]]]
    expected = sum(q.c for q in quadrics) / sum(np.trace(q.A) for q in quadrics)
    assert commit.log.error.numpy()[0] == pytest.approx(expected, rel=1e-3)
    assert expected > 0


def test_flags_are_joined_and_weights_averaged(device):
    points, faces = MESHES["open"]
    weight = np.arange(points.shape[1], dtype=float)
    commit = Commit(points, faces, (1, 7), device, locked=[7], cost_weight=weight)
    assert commit.state.vertex_flags.numpy()[7] == oracle.BORDER | oracle.LOCKED
    assert commit.state.cost_weight.numpy()[7] == 4


def test_log_names_ends_opposites_cost_and_pass(device):
    commit = closed_commit(device)
    u, v = commit.edge
    log = {
        name: getattr(commit.log, name).numpy()[0] for name in ("kept", "removed", "left_opposite", "right_opposite")
    }
    opposites = {w for f in commit.faces.tolist() if u in f and v in f for w in f} - {u, v}
    assert (log["kept"], log["removed"]) == (u, v)
    assert {log["left_opposite"], log["right_opposite"]} == opposites
    assert commit.log.count.numpy()[0] == 1
    assert commit.log.cost.numpy()[0] == 3
    assert commit.log.faces_removed.numpy()[0] == 2
    assert commit.log.round_index.numpy()[0] == 1


def test_log_of_a_border_edge_has_no_right_opposite(device):
    points, faces = MESHES["open"]
    log = Commit(points, faces, RIM_EDGE, device, faces_removed=1).log
    assert log.right_opposite.numpy()[0] == -1
    assert log.left_opposite.numpy()[0] in oracle.closed_neighbourhood(faces, {0, 1})


def test_neighbourhood_of_a_collapse_is_masked(device):
    commit = closed_commit(device)
    near = oracle.closed_neighbourhood(commit.faces, set(commit.edge))
    np.testing.assert_array_equal(np.flatnonzero(commit.mask.numpy() == PASS), sorted(near))


def test_selected_edge_that_removes_no_face_is_left_alone(device):
    commit = closed_commit(device, faces_removed=0)
    np.testing.assert_array_equal(commit.live_faces(), commit.faces)
    assert commit.log.count.numpy()[0] == 0
    assert not commit.mask.numpy().any()


def test_trajectory_of_the_kept_vertex_is_the_material_point(device):
    commit = closed_commit(device, with_trajectory=True)
    points = MESHES["closed"][0]
    u, v = commit.edge
    anchor = commit.anchor.numpy()[0]
    moved = commit.state.trajectory.numpy()
    np.testing.assert_allclose(moved[u], points[:, u] + anchor * (points[:, v] - points[:, u]), atol=1e-6)
    np.testing.assert_array_equal(moved[v], points[:, v])


@pytest.mark.parametrize("chunk_frames", [1, 2])
def test_trajectory_in_chunks_has_the_same_bits_and_moves_once(chunk_frames, device):
    whole = closed_commit(device, with_trajectory=True)
    parts = closed_commit(device, with_trajectory=True, chunk_frames=chunk_frames)
    assert parts.state.deformation.anchor.shape[1] > 1
    parts.move_trajectories(device)
    np.testing.assert_array_equal(parts.state.trajectory.numpy(), whole.state.trajectory.numpy())


def test_trajectory_is_the_same_material_point_whichever_way_the_half_edge_runs(device):
    points, faces = MESHES["closed"]
    u, v = sorted(faces[0, :2].tolist())
    there, back = (Commit(points, faces, edge, device, with_trajectory=True) for edge in ((u, v), (v, u)))
    np.testing.assert_allclose(there.state.trajectory.numpy()[u], back.state.trajectory.numpy()[u], atol=1e-5)


def test_compaction_keeps_live_faces_and_their_costs_and_seams_in_order(device):
    faces = meshes.icosphere(1)[1].copy()
    faces[[0, 3, 4, 50, len(faces) - 1]] = -1
    cost = np.arange(faces.size, dtype=np.float32)
    corner_vertex = wp.array(faces.ravel(), dtype=wp.int32, device=device)
    rank = wp.empty(len(faces), dtype=wp.int32, device=device)
    wp.launch(mark_live_faces, dim=len(faces), inputs=[corner_vertex], outputs=[rank], device=device)
    wp.utils.array_scan(rank, rank, inclusive=True)
    seam = (np.arange(faces.size) % 5 == 0).astype(np.int32)
    out = (
        wp.zeros_like(corner_vertex),
        wp.zeros(faces.size, dtype=wp.float32, device=device),
        wp.zeros_like(corner_vertex),
    )
    inputs = [corner_vertex, wp.array(cost, device=device), wp.array(seam, device=device), rank]
    wp.launch(move_live_faces, dim=len(faces), inputs=inputs, outputs=list(out), device=device)
    live = faces[:, 0] >= 0
    kept = 3 * live.sum()
    np.testing.assert_array_equal(out[0].numpy()[:kept].reshape(-1, 3), faces[live])
    np.testing.assert_array_equal(out[1].numpy()[:kept].reshape(-1, 3), cost.reshape(-1, 3)[live])
    np.testing.assert_array_equal(out[2].numpy()[:kept].reshape(-1, 3), seam.reshape(-1, 3)[live])


def test_log_and_pool_have_a_run_for_each_part(device):
    log = collapse_log(20, device)
    log.count.fill_(5)
    legal, space, slot, pool_slot, used = (
        wp.array(values, dtype=wp.int32, device=device)
        for values in ([3, 0, 4], [20, 0, 30], [0, 0, 0], [0, 0, 0], [100])
    )
    wp.launch(open_log, dim=1, inputs=[], outputs=[legal, space, log, slot, used, pool_slot], device=device)
    assert slot.numpy().tolist() == [5, 8, 8]
    assert log.count.numpy()[0] == 12
    assert pool_slot.numpy().tolist() == [100, 120, 120]
    assert used.numpy()[0] == 150
    assert not space.numpy().any()
    assert not legal.numpy().any()
