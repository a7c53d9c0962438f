"""Choice of a pass's candidates on meshes that are large enough for a sampled cap."""

import meshes
import numpy as np
import pytest
from mesh_state import build_state, cost_model

from warpqem.order.passes import CAP_FRACTION, Orderer
from warpqem.order.stars import build_stars


@pytest.fixture
def orderer(device):
    """A priced mesh of 61440 half-edges."""
    points, faces = meshes.icosphere(5)
    state = build_state(points, faces, device)
    orderer = Orderer(state, build_stars(state.corner_vertex, len(points)), cost_model(), len(faces), device)
    orderer._price_all()
    return orderer


def only_awake(orderer, half_edge):
    cost = np.full(len(orderer.state.edge_cost), np.inf, dtype=np.float32)
    cost[half_edge] = 1.0
    orderer.state.edge_cost.assign(cost)


@pytest.mark.parametrize("half_edge", [7 * 100, 7 * 100 + 1, 7 * 100 + 6])
def test_pass_after_one_without_a_winner_sees_every_edge(half_edge, orderer):
    for _ in range(2):  # a usual pass with either of the two lists of candidates first
        assert orderer._collect_candidates(10000, CAP_FRACTION) > 0
        orderer._candidates.reverse()
    only_awake(orderer, half_edge)
    assert orderer._collect_candidates(10000, 4 * CAP_FRACTION) == 1


def test_sampled_cap_is_near_the_exact_one(orderer):
    cost = orderer.state.edge_cost.numpy()
    wanted = int(CAP_FRACTION * 1.5 * orderer.live_faces)
    count = orderer._collect_candidates(10**6, CAP_FRACTION)
    assert np.isfinite(cost).sum() > 10 * wanted
    # A bin is up to 6 % wide, and costs of a regular mesh lie close together.
    assert wanted // 2 <= count <= 4 * wanted
