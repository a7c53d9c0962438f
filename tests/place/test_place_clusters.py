"""How firmly clusters of different sizes are held to the material."""

import numpy as np
import pytest

from tests.support import meshes
from warpqem.options import MeshOptions
from warpqem.pipeline.prepare import prepare
from warpqem.place.clusters import MAX_RELATIVE_SIZE, MIN_STIFFNESS, REGULARISED_SIZE


def stiffness_and_size(coherence, device):
    """Pull of each output vertex of a sphere, and the input vertices that it stands for."""
    points, faces = meshes.icosphere(4)
    options = MeshOptions(ratio=0.1, coherence=coherence, device=device)
    work = prepare(points, faces, options)
    placer = work.placer(work.order(None))
    return placer.clusters.rows["stiffness"], np.bincount(placer.vertex_map)


def test_stiffness_grows_with_the_square_root_of_the_size(device):
    stiffness, size = stiffness_and_size(0.5, device)
    assert len(np.unique(size)) > 3
    at_once = stiffness[size == 4][0] / 4**0.5
    held = size <= MAX_RELATIVE_SIZE * REGULARISED_SIZE
    np.testing.assert_allclose(stiffness[held], at_once * np.sqrt(size[held]), rtol=1e-5)


@pytest.mark.parametrize("coherence", [0.0, 0.1])
def test_no_cluster_is_pulled_less_than_float32_solves(coherence, device):
    assert stiffness_and_size(coherence, device)[0].min() >= np.float32(MIN_STIFFNESS)
