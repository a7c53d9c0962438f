"""The nearest components of samples, against distances to every face."""

import numpy as np
import trimesh
import warp as wp

from warpqem.kernels import component_distance as kernels

KEPT = int(kernels.NEAR_COMPONENTS)


def test_nearest_components_are_those_of_all_faces(device):
    rng = np.random.default_rng(5)
    count = 20
    points = (rng.uniform(-0.5, 0.5, (count, 1, 3)) + rng.normal(0, 0.05, (count, 6, 3))).reshape(-1, 3)
    points = points.astype(np.float32)
    # Two triangles in each component.
    faces = np.arange(6 * count, dtype=np.int32).reshape(-1, 3)
    component = np.repeat(np.arange(count, dtype=np.int32), 6)
    sample = np.arange(0, 6 * count, 3, dtype=np.int32)
    mesh = wp.Mesh(
        points=wp.array(points, dtype=wp.vec3, device=device), indices=wp.array(faces.ravel(), device=device)
    )
    near = wp.empty((len(sample), KEPT), dtype=wp.int32, device=device)
    squared = wp.empty((len(sample), KEPT), dtype=wp.float32, device=device)
    wp.launch(
        kernels.find_near_components,
        dim=len(sample),
        inputs=[
            mesh.id,
            wp.array(component, device=device),
            wp.array(sample, device=device),
            wp.full(len(sample), 0.5, dtype=wp.float32, device=device),
        ],
        outputs=[near, squared],
        device=device,
    )
    for row, found, distances in zip(sample, near.numpy(), squared.numpy(), strict=True):
        closest = trimesh.triangles.closest_point(points[faces], np.repeat(points[row][None], len(faces), axis=0))
        to_face = ((closest - points[row]) ** 2).sum(axis=1)
        to_component = to_face.reshape(count, 2).min(axis=1)
        to_component[component[row]] = np.inf
        kept = found >= 0
        assert kept[0]
        expected = np.argsort(to_component)[: kept.sum()]
        np.testing.assert_array_equal(found[kept], expected)
        np.testing.assert_allclose(distances[kept], to_component[expected], rtol=1e-4, atol=1e-9)
