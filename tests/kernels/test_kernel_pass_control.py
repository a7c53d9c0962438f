"""What a pass leaves out to end at its target, and what its collapses ask for afterwards."""

import numpy as np
import pytest
import warp as wp

from tests.support import meshes
from tests.support.mesh_state import build_mesh, collapse_log, edge_list, one_part
from warpqem.kernels import pass_control as kernels
from warpqem.kernels.pass_control import PassControl, Upkeep

wp.set_module_options({"enable_backward": False})  # no gradients are taken

EDGES = np.array([4, 40, 90, 200, 300], dtype=np.int32)
FACES = np.array([2, 1, 0, 2, 2], dtype=np.int32)


def number(value, device) -> wp.array:
    return wp.array([value], dtype=wp.int32, device=device)


def control_of(live, target, device) -> PassControl:
    control = PassControl()
    control.live_faces, control.target_faces = number(live, device), number(target, device)
    control.removed_faces, control.pass_begin = number(0, device), number(3, device)
    return control


@pytest.fixture
def mesh(device):
    """A mesh on which some edges cost more the later they come, but for the last, which is the cheapest."""
    mesh = build_mesh(*meshes.swaying_sphere(2, 2), device)
    cost = np.full(len(mesh.state.edge_cost), np.inf, dtype=np.float32)
    cost[EDGES] = [2.0, 3.0, 4.0, 5.0, 1.0]
    mesh.state.edge_cost = wp.array(cost, dtype=wp.float32, device=device)
    return mesh


@pytest.mark.parametrize(
    ("to_remove", "kept"),
    [
        (9, [2, 1, 0, 2, 2]),
        (7, [2, 1, 0, 2, 2]),
        (6, [2, 1, 0, 2, 2]),
        (5, [2, 1, 0, 0, 2]),
        (3, [2, 0, 0, 0, 2]),
        (1, [0, 0, 0, 0, 2]),
        (0, [0, 0, 0, 0, 0]),
    ],
)
def test_the_costliest_collapses_beyond_the_target_are_left_out(to_remove, kept, mesh, device):
    control, selected = control_of(100, 100 - to_remove, device), edge_list(EDGES, device)
    faces, trimmed = (wp.array(FACES, dtype=wp.int32, device=device) for _ in range(2))
    legal = number(0, device)
    inputs, outputs = [mesh.state, selected, faces], [control, trimmed, legal]
    wp.launch(kernels.trim_in_order, 1, inputs, outputs, device=device)
    assert trimmed.numpy().tolist() == kept
    assert legal.numpy()[0] == np.count_nonzero(kept)
    assert control.live_faces.numpy()[0] == 100 - sum(kept)


@pytest.mark.parametrize("to_remove", range(9))
def test_one_thread_leaves_out_what_many_do(to_remove, mesh, device):
    selected, faces = edge_list(EDGES, device), wp.array(FACES, dtype=wp.int32, device=device)
    kept = []
    for kernel, rest in ((kernels.trim_in_order, []), (kernels.trim_collapses, [one_part(device)])):
        control, trimmed = control_of(100, 100 - to_remove, device), wp.zeros_like(faces)
        outputs = [control, trimmed, *([] if rest else [number(0, device)])]
        wp.launch(kernel, 1, [mesh.state, selected, faces, *rest], outputs, device=device)
        kept.append(trimmed.numpy().tolist())
    assert kept[0] == kept[1]


@pytest.mark.parametrize(
    ("collapses", "live_share", "used_share", "expected"),
    [
        (3, 0.5, 2.0, [0, 0, 0, 0]),
        (5, 1.0, 1.0, [1, 0, 0, 1]),
        (5, 0.69, 1.0, [1, 1, 1, 0]),
        (5, 0.71, 1.0, [1, 0, 0, 1]),
        (5, 1.0, 1.1, [1, 0, 1, 0]),
    ],
    ids=["none", "few", "many faces gone", "not quite so many", "full pool"],
)
def test_upkeep_is_what_collapses_ask_for(collapses, live_share, used_share, expected, mesh, device):
    state, log, upkeep = mesh.state, collapse_log(10, device), Upkeep()
    face_count = int(state.face_count.numpy()[0])
    log.count.fill_(collapses)
    state.adjacency.used.fill_(int(used_share * len(state.adjacency.corner)))
    for name in ("any", "compacts", "builds", "updates"):
        setattr(upkeep, name, number(-1, device))
    inputs = [state, log, control_of(int(live_share * face_count), 0, device)]
    wp.launch(kernels.find_upkeep, 1, inputs, [upkeep], device=device)
    assert [int(getattr(upkeep, name).numpy()[0]) for name in ("any", "compacts", "builds", "updates")] == expected
