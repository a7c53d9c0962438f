"""Pairs of seams: what counts across a seam along the surface, and off it."""

import numpy as np
import pytest
import warp as wp

from tests.support import meshes
from warpqem.decimation.adjacency import build_adjacency
from warpqem.kernels import refit as kernels
from warpqem.refit import matching
from warpqem.refit.seam_edges import SeamEdges

ASIDE, ABOVE = 0.05, 0.02


def sheet(offset, faces, marks, device):
    points = meshes.grid(4, 4)[0] + np.asarray(offset, dtype=np.float32)
    corner_vertex = wp.array(faces.ravel(), dtype=wp.int32, device=device)
    on_device = wp.array(points[None].astype(np.float32), dtype=wp.vec3, device=device)
    return matching.make_surface(on_device, corner_vertex, build_adjacency(corner_vertex, len(points)), marks)


@pytest.fixture
def pairs(device):
    """(normals, residuals, weights) of both pairs of each point, of a sheet and one beside and above it."""
    _, faces = meshes.grid(4, 4)
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    column = np.arange(5) * 5 + 2
    seams = SeamEdges.of(faces, np.isin(tail, column) & np.isin(head, column))
    there, no_border = np.arange(25, dtype=np.int32), np.zeros(0, dtype=np.int32)
    sizes = wp.ones(int(kernels.SIZES), dtype=wp.float32, device=device)
    found = matching.Matching(
        sheet((ASIDE, 0, ABOVE), faces, seams.marks, device),
        sheet((0, 0, 0), faces, seams.marks, device),
        there,
        faces,
        faces,
        wp.array(there, dtype=wp.int32, device=device),
        1,
        sizes,
        (no_border, no_border),
        (seams.half_edge, seams.half_edge),
        device,
    )
    found.find(1.0)
    # Those of seams come last.
    count = 2 * len(seams.half_edge) * (matching.INPUT_LINE_SAMPLES + matching.OUTPUT_LINE_SAMPLES)
    store = found.input_pairs
    assert (store.face.numpy()[: len(store.normal)][-count:] >= 0).all()
    return [array.numpy()[-count:].reshape(count // 2, 2, -1) for array in (store.normal, store.residual, store.weight)]


def test_first_pair_of_a_seam_is_along_the_surface_and_the_other_off_it(pairs):
    normal, residual, _ = pairs
    np.testing.assert_allclose(np.abs(normal[:, 0]), np.tile([1, 0, 0], (len(normal), 1)), atol=1e-6)
    np.testing.assert_allclose(np.abs(normal[:, 1]), np.tile([0, 0, 1], (len(normal), 1)), atol=1e-6)
    np.testing.assert_allclose(np.abs(residual[..., 0]), np.tile([ASIDE, ABOVE], (len(normal), 1)), atol=1e-6)


def test_off_the_surface_a_seam_counts_half(pairs):
    weight = pairs[2][..., 0]
    np.testing.assert_allclose(weight[:, 1], 0.5 * weight[:, 0], rtol=1e-6)
