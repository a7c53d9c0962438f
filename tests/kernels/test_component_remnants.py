"""Which components have nothing better to do than to go as a whole: kernels against NumPy."""

from __future__ import annotations

import numpy as np
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.mesh_state import corners_of, one_part, state_of_costs
from warpqem.kernels.components import MAX_REMNANT_FACES, MAX_STUCK_FACES, mark_remnants, measure_components

COST = st.one_of(
    st.floats(0, 10, width=32), st.sampled_from([np.inf, 0.0]), st.floats(-10, -0.0, width=32), st.just(-0.0)
)


@settings(max_examples=60)
@given(
    component=st.lists(st.integers(0, 3), min_size=1, max_size=12),
    dead=st.sets(st.integers(0, 11)),
    data=st.data(),
)
def test_faces_and_the_cheapest_edge_of_each_component_are_found(device, component, dead, data):
    count = len(component)
    costs = np.array(data.draw(st.lists(COST, min_size=3 * count, max_size=3 * count)), dtype=np.float32)
    faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    live = np.array([f not in dead for f in range(count)])
    state = state_of_costs(costs, device)
    state.corner_vertex = corners_of(np.where(live[:, None], faces, -1), device)
    of_vertex = wp.array(np.repeat(component, 3).astype(np.int32), device=device)
    sizes, cheapness, marks, number = (wp.zeros(n, dtype=wp.int32, device=device) for n in (4, 4, 4, 1))
    work = one_part(device)
    wp.launch(measure_components, 1, inputs=[state, of_vertex, work], outputs=[sizes, cheapness], device=device)
    own = [live & (np.array(component) == c) for c in range(4)]
    assert sizes.numpy().tolist() == [int(mask.sum()) for mask in own]
    cost = costs.reshape(-1, 3)
    # A negative cost, -0.0 too, is that of a suspended edge.
    legal = np.where(np.signbit(cost), np.inf, cost)
    cheapest = np.array([legal[mask].min(initial=np.inf) for mask in own])
    losses, threshold = np.array([0.0, 2.0, 0.5, np.inf], dtype=np.float32), 1.0
    arrays = [wp.array(values, dtype=wp.float32, device=device) for values in (losses, [threshold])]
    wp.launch(mark_remnants, 1, inputs=[sizes, cheapness, *arrays, work], outputs=[marks, number], device=device)
    size = sizes.numpy()
    looked_at = (size <= int(MAX_STUCK_FACES)) | np.isinf(cheapest)
    stuck = (size <= int(MAX_REMNANT_FACES)) | (looked_at & (cheapest >= threshold))
    cost_of_loss = losses * np.minimum(1.0, int(MAX_REMNANT_FACES) / np.maximum(size, 1))
    expected = (size > 0) & stuck & (cost_of_loss <= threshold)
    assert marks.numpy().astype(bool).tolist() == expected.tolist()
    assert number.numpy()[0] == expected.sum()
