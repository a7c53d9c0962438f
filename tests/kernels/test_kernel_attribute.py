"""The attribute error of a collapse, and what a collapse leaves of the wedges."""

import numpy as np
import pytest
import warp as wp

from tests.oracles.attributes import AttributeClusters
from tests.oracles.topology import collapsed
from tests.support import meshes
from tests.support.mesh_state import (
    build_mesh,
    collapse_log,
    corners_of,
    edge_list,
    half_edge_between,
    one_part,
    packed,
)
from warpqem.decimation.adjacency import build_adjacency
from warpqem.decimation.attribute_quadrics import build_wedges
from warpqem.kernels.attribute import attribute_error, move_corner_wedges
from warpqem.kernels.collapse import commit_collapses
from warpqem.kernels.mesh_state import MeshState, Point


@wp.kernel
def measure_merged_attributes(
    # in
    state: MeshState,
    ends_in: wp.array[wp.vec2i],
    point_in: wp.array[Point],
    # out
    error_out: wp.array[wp.float32],
):
    """``E`` of each edge's merged vertex at a point of the reference frame."""
    i = wp.tid()
    error_out[i] = attribute_error(state, ends_in[i][0], ends_in[i][1], point_in[i])


def bumpy(points):
    """Two channels that are linear nowhere, (V, 2)."""
    return np.stack([np.sin(5 * points[:, 0]) + points[:, 1], np.cos(4 * points[:, 2]) * points[:, 0]], axis=1)


def smooth_case():
    points, faces = meshes.bumpy_sphere(1)
    return points, faces, bumpy(points)[faces]


def seam_case():
    """Two charts that meet in a line from border to border, and a third that begins inside."""
    points, faces = meshes.grid(6, 6)
    points[:, 2] = 0.1 * np.sin(6 * points[:, 0]) * np.cos(5 * points[:, 1])
    values = bumpy(points)[faces]
    centre = points[faces].mean(axis=1)
    values[centre[:, 0] > 0.5] += [3.0, -1.0]
    values[(centre[:, 0] < 0.5) & (centre[:, 1] > 0.5)] *= 2.0
    return points, faces, values


def slit_case():
    """One chart cut along a line that ends inside the mesh: at its ends both sides have one value."""
    points, faces = meshes.grid(6, 6)
    values = bumpy(points)[faces]
    # The upper side of the cut from (1/3, 1/2) to (2/3, 1/2), at the one vertex between its ends.
    middle = np.flatnonzero((np.abs(points[:, :2] - 0.5) < 1e-6).all(axis=1))[0]
    above = points[faces].mean(axis=1)[:, 1] > 0.5
    values[(faces == middle) & above[:, None]] += 0.7
    return points, faces, values


CASES = {"smooth": smooth_case, "seams": seam_case, "slit": slit_case}


class Mesh:
    """A mesh with wedges on the device, beside the oracle's."""

    def __init__(self, points, faces, values, device):
        self.device, self.faces = device, faces.copy()
        mesh = build_mesh(points, faces, device)
        self.state, self.frames = mesh.state, mesh.frames
        self.state.wedges = build_wedges(corners_of(faces, device), mesh.frames.position, values, 1)
        self.clusters = AttributeClusters(points, faces, values)

    def edges(self):
        """(E, 2), lower vertex first."""
        ends = np.concatenate([self.faces[:, [k, (k + 1) % 3]] for k in range(3)])
        return np.unique(np.sort(ends, axis=1), axis=0)

    def position(self):
        """(V, 3)."""
        return self.state.wedges.position.numpy()[..., 0]

    def errors(self, edges, points):
        out = wp.empty(len(edges), dtype=wp.float32, device=self.device)
        inputs = [
            self.state,
            wp.array(edges, dtype=wp.vec2i, device=self.device),
            wp.array(np.float32(points)[..., None], dtype=Point, device=self.device),
        ]
        wp.launch(measure_merged_attributes, dim=len(edges), inputs=inputs, outputs=[out], device=self.device)
        return out.numpy()

    def check_all_edges(self, rng):
        edges = self.edges()
        position = self.position()
        points = position[edges].mean(axis=1) + rng.normal(0, 0.05, (len(edges), 3))
        expected = [self.clusters.error(int(u), int(v), x) for (u, v), x in zip(edges, points, strict=True)]
        np.testing.assert_allclose(self.errors(edges, points), expected, rtol=1e-3, atol=1e-5 * max(expected))

    def collapsible(self, rng):
        """An edge with as many common neighbours as faces."""
        for u, v in rng.permutation(self.edges()):
            rings = [set(self.faces[(self.faces == w).any(axis=1)].ravel()) - {u, v} for w in (u, v)]
            if len(rings[0] & rings[1]) == ((self.faces == u).any(axis=1) & (self.faces == v).any(axis=1)).sum():
                return int(u), int(v)
        raise AssertionError("no edge left")

    def collapse(self, u, v, x):
        """Collapse ``v`` into ``u``, lower, at ``x``."""
        live = self.state.corner_vertex.numpy().reshape(-1, 3)
        try:
            half_edge = half_edge_between(live, u, v)
        except IndexError:
            half_edge = half_edge_between(live, v, u)
        removed, number, slot = (wp.array([n], dtype=wp.int32, device=self.device) for n in (2, 1, 0))
        inputs = [
            self.state,
            self.frames,
            edge_list([half_edge], self.device),
            removed,
            packed(np.reshape(x, (1, 1, 3)), self.device),
            wp.array([0.5], dtype=wp.float32, device=self.device),
            wp.zeros(1, dtype=wp.float32, device=self.device),
            number,
            one_part(self.device),
        ]
        vertex_count = len(self.state.vertex_flags)
        mask = wp.zeros(vertex_count, dtype=wp.int32, device=self.device)
        pool_slot = wp.clone(self.state.adjacency.used)
        outputs = [mask, collapse_log(4, self.device), slot, pool_slot]
        wp.launch(commit_collapses[1], dim=1, inputs=inputs, outputs=outputs, device=self.device)
        adjacency = build_adjacency(self.state.corner_vertex, vertex_count, self.state.face_count)
        self.state.adjacency = adjacency.lists
        self.clusters.merge(u, v)
        self.faces = collapsed(self.faces, u, v)


@pytest.mark.parametrize("case", CASES)
def test_error_of_every_edge_matches_the_oracle(case, device):
    Mesh(*CASES[case](), device).check_all_edges(np.random.default_rng(0))


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", range(3))
def test_error_of_every_edge_matches_the_oracle_after_collapses(case, seed, device):
    rng = np.random.default_rng(seed)
    mesh = Mesh(*CASES[case](), device)
    for _ in range(8):
        u, v = mesh.collapsible(rng)
        position = mesh.position()
        mesh.collapse(u, v, position[[u, v]].mean(axis=0) + rng.normal(0, 0.02, 3))
    mesh.check_all_edges(rng)


def test_seam_edge_ending_at_one_value_matches_the_oracle(device):
    mesh = Mesh(*slit_case(), device)
    middle = int(np.flatnonzero(np.bincount(mesh.clusters.wedge_vertex) == 2)[0])
    neighbour = middle - 1
    mesh.collapse(neighbour, middle, np.array([0.45, 0.5, 0.0]))
    mesh.check_all_edges(np.random.default_rng(1))


def test_linear_attribute_on_a_plane_costs_nothing(device):
    points, faces = meshes.grid(5, 5)
    mesh = Mesh(points, faces, (points @ np.array([[2.0, 1.0], [-3.0, 0.5], [0.0, 0.0]]))[faces], device)
    edges = mesh.edges()
    assert mesh.errors(edges, points[edges].mean(axis=1)).max() < 1e-10


def test_charts_are_not_compared(device):
    points, faces, values = seam_case()
    right = points[faces].mean(axis=1)[:, 0] > 0.5
    moved = values.copy()
    moved[right] -= [2.0, 2.0]
    meshes_ = [Mesh(points, faces, v, device) for v in (values, moved)]
    edges = meshes_[0].edges()
    first, second = (mesh.errors(edges, points[edges].mean(axis=1)) for mesh in meshes_)
    np.testing.assert_allclose(first, second, rtol=1e-3, atol=1e-5 * first.max())


def test_error_counts_once_for_every_key_frame(device):
    points, faces, values = smooth_case()
    position = packed(points[None], device)
    one, four = (build_wedges(corners_of(faces, device), position, values, k).quadric.numpy() for k in (1, 4))
    np.testing.assert_allclose(four, 4 * one, rtol=1e-4, atol=1e-5 * one.max())


def test_face_without_area_adds_nothing(device):
    points, faces, values = smooth_case()
    points[faces[3, 0]] = points[faces[3, 1]]
    wedges = build_wedges(corners_of(faces, device), packed(points[None], device), values, 1)
    assert np.isfinite(wedges.quadric.numpy()).all()
    assert np.isfinite(wedges.gradient.numpy()).all()


def test_wedges_move_with_the_live_faces(device):
    faces = np.array([[0, 1, 2], [-1, -1, -1], [2, 1, 3]], dtype=np.int32)
    rank, wedge = np.array([1, 1, 2], dtype=np.int32), np.arange(9, dtype=np.int32)
    out = wp.full(9, -1, dtype=wp.int32, device=device)
    inputs = [wp.array(a, dtype=wp.int32, device=device) for a in (faces.ravel(), wedge, rank)]
    wp.launch(move_corner_wedges, dim=3, inputs=inputs, outputs=[out], device=device)
    assert out.numpy().tolist() == [0, 1, 2, 6, 7, 8, -1, -1, -1]
