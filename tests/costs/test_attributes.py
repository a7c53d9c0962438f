"""Attributes in the order of collapses."""

import numpy as np
import pytest

import warpqem
from tests.support import meshes
from warpqem.costs import AttributeField
from warpqem.errors import MeshShapeError, OptionError
from warpqem.runtime import cpu_threads as parallel

# A flat grid whose texture is three times as fine right of a line of vertices.
POINTS, FACES = meshes.grid(20, 20)
LINE = 0.45


def texture(x: np.ndarray) -> np.ndarray:
    return np.where(x < LINE, x, LINE + 3 * (x - LINE))


BENT = np.stack([texture(POINTS[:, 0]), POINTS[:, 1]], axis=1)


def bent_result(weight: float, device, **options) -> warpqem.SimplifiedMesh:
    return warpqem.simplify(
        POINTS, FACES, ratio=0.1, attributes=[AttributeField(BENT, weight)], device=device, **options
    )


def texture_error(result: warpqem.SimplifiedMesh) -> float:
    """Mean error over the faces of the texture between exact corners."""
    corners = result.points[0, result.faces, 0]
    blend = np.random.default_rng(0).dirichlet(np.ones(3), size=100)
    return float(np.abs(texture(corners) @ blend.T - texture(corners @ blend.T)).mean())


@pytest.mark.parametrize("weight", [0.01, 0.1, 1.0])
def test_line_where_the_texture_bends_keeps_its_vertices(weight, device):
    off, on = bent_result(0.0, device), bent_result(weight, device)
    line = [(np.abs(result.points[0, :, 0] - LINE) < 1e-3).sum() for result in (off, on)]
    assert line[0] <= 1
    assert line[1] >= 4
    assert texture_error(on) < 0.02 * texture_error(off)


def test_line_is_kept_by_corner_values_and_in_motion(device):
    frames = meshes.rigid_motion(POINTS, 4)
    result = warpqem.simplify(frames, FACES, ratio=0.1, attributes=[AttributeField(BENT[FACES], 0.1)], device=device)
    assert (np.abs(result.points[0, :, 0] - LINE) < 1e-3).sum() >= 4


@pytest.mark.parametrize("metric", ["qem", "dsd", "dod", "aqem"])
@pytest.mark.parametrize("placement", ["optimal", "endpoint"])
def test_weight_lowers_the_texture_error_with_every_cost_model(metric, placement, device):
    points, faces = meshes.waving_grid(20, 4)
    value = texture(POINTS[:, 0])
    error = []
    for weight in (0.0, 1.0):
        result = warpqem.simplify(
            points,
            faces,
            ratio=0.15,
            metric=metric,
            quality="fast",
            placement=placement,
            attributes=[AttributeField(value, weight)],
            device=device,
        )
        error.append(texture_error(result))
    assert error[1] < 0.7 * error[0]


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_seams_stay_seams(weight, device):
    middle = np.flatnonzero(np.abs(POINTS[:, 0] - 0.5) < 1e-6)
    values = BENT[FACES]
    values[POINTS[FACES].mean(axis=1)[:, 0] > 0.5] += 10
    seams = np.stack([middle[:-1], middle[1:]], axis=1)
    result = warpqem.simplify(
        POINTS, FACES, ratio=0.1, seams=seams, attributes=[AttributeField(values, weight)], device=device
    )
    x = result.points[0, result.faces, 0]
    assert not ((x < 0.499) & (x.max(axis=1) > 0.501)[:, None]).any()


def test_weight_nought_is_as_no_attribute(device):
    points, faces = meshes.swaying_sphere(2, 4)
    plain = warpqem.simplify(points, faces, ratio=0.2, device=device)
    attributes = [AttributeField(points[0] @ np.ones((3, 2)), 0.0)]
    weighted = warpqem.simplify(points, faces, ratio=0.2, attributes=attributes, device=device)
    np.testing.assert_array_equal(plain.points, weighted.points)
    np.testing.assert_array_equal(plain.faces, weighted.faces)


def test_error_stays_that_of_the_shape(device):
    points, faces = meshes.swaying_sphere(2, 4)
    attributes = [AttributeField(100 * np.sin(20 * points[0]))]
    result = warpqem.simplify(points, faces, max_error=1.0, attributes=attributes, device=device)
    plain = warpqem.simplify(points, faces, max_error=1.0, device=device)
    assert result.error <= 1.0
    assert 0.5 * len(plain.faces) < len(result.faces) < 2 * len(plain.faces)


def test_reruns_are_equal_to_the_bit_on_any_number_of_threads(monkeypatch):
    points, faces = meshes.swaying_sphere(3, 4)
    attributes = [AttributeField(np.sin(5 * points[0]), 0.5)]
    results = []
    for threads in (1, 2, 2):
        monkeypatch.setattr(parallel, "_core_count", lambda threads=threads: threads)
        results.append(warpqem.simplify(points, faces, ratio=0.2, attributes=attributes, device="cpu"))
    for other in results[1:]:
        np.testing.assert_array_equal(results[0].faces, other.faces)
        np.testing.assert_array_equal(results[0].points, other.points)


def test_unused_faces_of_the_input_do_not_shift_corner_values(device):
    extra = np.array([[0, 0, 1]], dtype=np.int32)
    values = np.concatenate([np.full((1, 3, 2), 77.0), BENT[FACES]])
    faces = np.concatenate([extra, FACES])
    result = warpqem.simplify(POINTS, faces, target_faces=80, attributes=[AttributeField(values, 0.1)], device=device)
    assert (np.abs(result.points[0, :, 0] - LINE) < 1e-3).sum() >= 4


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.zeros((3, 2)), r"attributes\[0\].values must be numbers of shape \(441, C\) .* \(800, 3, C\) .* \(3, 2\)"),
        (np.zeros((800, 4, 2)), r"got shape \(800, 4, 2\)"),
        (np.zeros((441, 0)), r"got shape \(441, 0\)"),
        (np.full(441, "a"), "dtype <U1"),
        (np.where(np.arange(441) == 7, np.nan, 0.0), r"attributes\[0\].values at \(7, 0\) is nan"),
    ],
)
def test_wrong_values_are_refused(values, message):
    with pytest.raises(MeshShapeError, match=message):
        warpqem.simplify(POINTS, FACES, ratio=0.5, attributes=[AttributeField(values, 0.0)], device="cpu")


@pytest.mark.parametrize("weight", [-1.0, np.nan, np.inf, 1e7])
def test_weight_out_of_range_is_refused(weight):
    with pytest.raises(OptionError, match=r"attributes\[0\].weight must be in \[0, 1e\+06\], got"):
        bent_result(weight, "cpu")


@pytest.mark.parametrize(("size", "weight"), [(1e20, 1.0), (1e12, 1e4)])
def test_values_too_far_apart_for_single_precision_are_refused(size, weight):
    values = np.zeros((441, 2))
    values[7, 1] = size
    with pytest.raises(
        OptionError, match=r"attributes\[0\]: channel 1 spans 1e\+\d+, times its weight, expected at most 1e\+15"
    ):
        warpqem.simplify(POINTS, FACES, ratio=0.5, attributes=[AttributeField(values, weight)], device="cpu")


def test_values_just_near_enough_for_single_precision_give_a_sound_result(device):
    values = np.random.default_rng(0).random((441, 2)) * 1e15
    result = warpqem.simplify(POINTS, FACES, max_error=5.0, attributes=[AttributeField(values)], device=device)
    assert np.isfinite(result.points).all()
