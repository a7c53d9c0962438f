"""How firmly clusters of different sizes are held to the material."""

import numpy as np
import pytest
import warp as wp

import warpqem
from tests.support import meshes
from warpqem.options import MeshOptions
from warpqem.pipeline.prepare import prepare
from warpqem.place.stiffness import MAX_RELATIVE_SIZE, MIN_STIFFNESS, REGULARISED_SIZE


def stiffness_and_size(coherence, device):
    """Pull of each output vertex of a sphere, and the input vertices that it stands for."""
    points, faces = meshes.icosphere(4)
    options = MeshOptions(ratio=0.1, coherence=coherence, device=device)
    work = prepare(points, faces, options)
    placer = work.placer(work.order(None))
    stiffness = placer.clusters.rows["stiffness"]
    return stiffness.numpy() if isinstance(stiffness, wp.array) else stiffness, np.bincount(placer.vertex_map)


def test_stiffness_grows_with_the_square_root_of_the_size(device):
    stiffness, size = stiffness_and_size(0.5, device)
    assert len(np.unique(size)) > 3
    held = size <= MAX_RELATIVE_SIZE * REGULARISED_SIZE
    single = stiffness[held] / np.sqrt(size[held])
    np.testing.assert_allclose(single, single[0], rtol=1e-5)


@pytest.mark.parametrize("coherence", [0.0, 0.1])
def test_no_cluster_is_pulled_less_than_float32_solves(coherence, device):
    assert stiffness_and_size(coherence, device)[0].min() >= np.float32(MIN_STIFFNESS)


def capped_tube(sides=24, rings=8, discs=12) -> tuple[np.ndarray, np.ndarray]:
    """A tube with few rings, and ends of many narrow discs: flat places that reach up to an edge."""
    radius = np.concatenate([np.linspace(0.05, 1, discs), np.ones(rings), np.linspace(1, 0.05, discs)[1:]])
    height = np.concatenate([np.zeros(discs), np.linspace(0, 4, rings + 1)[1:], np.full(discs - 1, 4.0)])
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    points = np.stack(
        [
            radius[:, None] * np.cos(angle),
            radius[:, None] * np.sin(angle),
            np.broadcast_to(height[:, None], (len(radius), sides)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    row, side = np.divmod(np.arange((len(radius) - 1) * sides), sides)
    a, b = row * sides + side, row * sides + (side + 1) % sides
    faces = np.concatenate([np.stack([a, b, b + sides], 1), np.stack([a, b + sides, a + sides], 1)])
    return points[None].astype(np.float32), faces.astype(np.int32)


@pytest.mark.parametrize("quality", ["fast", "best"])
@pytest.mark.parametrize("ratio", [0.2, 0.3, 0.5])
def test_the_rim_of_a_flat_end_is_not_drawn_inwards(quality, ratio, device):
    points, faces = capped_tube()
    free, held = (
        warpqem.simplify(points, faces, ratio=ratio, coherence=c, quality=quality, device=device).measured
        for c in (0.0, 0.5)
    )
    assert held.hausdorff < 1.5 * free.hausdorff + 0.05
