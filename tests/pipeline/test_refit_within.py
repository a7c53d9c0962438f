"""``max_error`` with a refit: what it would take beyond the limit stays as it was placed."""

import numpy as np
import pytest

import warpqem
from tests.support import meshes
from warpqem.arguments.distance_limit import DistanceLimit
from warpqem.frames.stream import NoFrames
from warpqem.mesh.mesh_input import read_mesh
from warpqem.pipeline import place_frames
from warpqem.pipeline.bound_sink import BoundSink
from warpqem.pipeline.bounded_frames import SettledFrames
from warpqem.pipeline.cut_levels import LevelFrames

BAR = meshes.bending_bar(20, 40, frames=6)


def prove(mesh, result, limit, device):
    """Raise where a point of either surface is beyond the limit, in % of the diagonal."""
    given = read_mesh(*mesh)
    diagonal = float(np.linalg.norm(np.ptp(mesh[0], axis=1), axis=1).max())
    bound = BoundSink(NoFrames(), given, DistanceLimit(limit / 100), diagonal, device)
    bound.begin(len(result.points), result.points.shape[1], result.faces)
    bound.write(slice(0, len(result.points)), result.points)


def test_a_refit_adds_no_face_and_leaves_vertices_where_it_would_take_them_too_far(device):
    # At full coherence a refit softens no cluster.
    placed = warpqem.simplify(*BAR, max_error=0.2, coherence=1.0, refit=False, device=device)
    fitted = warpqem.simplify(*BAR, max_error=0.2, coherence=1.0, device=device)
    assert np.array_equal(fitted.faces, placed.faces)
    stays = (fitted.points == placed.points).all(axis=(0, 2))
    assert 0 < stays.sum() < len(stays)
    assert fitted.measured.rms < placed.measured.rms
    prove(BAR, fitted, 0.2, device)


def test_vertices_that_a_refit_leaves_are_where_they_were_proved(device, monkeypatch):
    proved, held = [], []
    points, is_settled = LevelFrames.points, SettledFrames.is_settled

    def recorded_points(self, level):
        proved.append(points(self, level))
        return proved[-1]

    def recorded_held(self):
        held.append(self.held)
        return is_settled(self)

    monkeypatch.setattr(LevelFrames, "points", recorded_points)
    monkeypatch.setattr(SettledFrames, "is_settled", recorded_held)
    # Here a refit makes all clusters softer.
    result = warpqem.simplify(*BAR, max_error=0.03, device=device)
    assert held[-1].any()
    np.testing.assert_array_equal(result.points[:, held[-1]], proved[-1][:, held[-1]])


def test_a_refit_within_a_limit_is_solved_once(device, monkeypatch):
    solved, fit = [], place_frames.fit_corrections

    def counted(*arguments):
        solved.append(arguments)
        return fit(*arguments)

    monkeypatch.setattr(place_frames, "fit_corrections", counted)
    warpqem.simplify(*BAR, max_error=0.2, device=device)
    assert len(solved) == 1


@pytest.mark.parametrize("quality", ["fast", "best"])
def test_frames_that_are_too_many_to_be_kept_are_all_proved(quality, device, monkeypatch):
    monkeypatch.setattr("warpqem.pipeline.bounded.KEPT_BYTES", 0)
    monkeypatch.setattr("warpqem.pipeline.memory_plan.KEPT_BYTES", 0)
    mesh = meshes.bending_bar(12, 24, frames=24)
    prove(mesh, warpqem.simplify(*mesh, max_error=0.5, quality=quality, device=device), 0.5, device)
