"""Every named error, and what its message says."""

import numpy as np
import pytest
import trimesh

import warpqem
from tests.support import meshes
from warpqem import errors

POINTS, FACES = meshes.icosphere(1)
FRAMES = np.stack([POINTS] * 3)


def refused(error, match, points=FRAMES, faces=FACES, **options):
    options = {"ratio": 0.5, "device": "cpu"} | options
    with pytest.raises(error, match=match):
        warpqem.simplify(points, faces, **options)


def changed(array, index, value):
    array = array.copy()
    array[index] = value
    return array


@pytest.mark.parametrize("shape", [(4,), (4, 2), (2, 4, 2), (1, 2, 4, 3)])
def test_points_of_another_shape_are_refused(shape):
    refused(errors.MeshShapeError, rf"points must have shape .* got \({', '.join(map(str, shape))},?\)", np.ones(shape))


@pytest.mark.parametrize("dtype", [bool, complex, str, object])
def test_points_of_another_dtype_are_refused(dtype):
    refused(errors.MeshShapeError, "points must be real numbers, got dtype", FRAMES.astype(dtype))


@pytest.mark.parametrize("faces", [np.zeros((3, 4), int), np.zeros(3, int), np.zeros((2, 3, 1), int)])
def test_faces_of_another_shape_are_refused(faces):
    refused(errors.MeshShapeError, r"faces must have shape \(N, 3\), got", faces=faces)


@pytest.mark.parametrize("dtype", [float, bool])
def test_faces_of_another_dtype_are_refused(dtype):
    refused(errors.MeshShapeError, "faces must be integers, got dtype", faces=FACES.astype(dtype))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("frame", [0, 2])
def test_point_that_is_not_finite_is_named(frame, value, dtype):
    points = changed(FRAMES.astype(dtype), (frame, 17, 1), value)
    refused(errors.NonFinitePointError, rf"vertex 17 in frame {frame} has y = {value} \(1 such", points)


def test_number_of_points_that_are_not_finite_is_named():
    points = changed(FRAMES, (1, slice(4, 8)), np.nan)
    refused(errors.NonFinitePointError, r"vertex 4 in frame 1 has x = nan \(4 such points", points)


def test_coordinate_beyond_single_precision_is_named_with_its_value():
    points = changed(FRAMES.astype(np.float64), (1, 17, 1), 1e300)
    refused(errors.WarpqemError, r"vertex 17 in frame 1 .*1e\+300", points)


@pytest.mark.parametrize("index", [-1, 42, 2**31])
def test_face_index_out_of_range_is_named(index):
    faces = changed(FACES.astype(np.int64), (7, 2), index)
    refused(errors.FaceIndexError, rf"face 7 corner 2 refers to vertex {index}, but there are 42", faces=faces)


@pytest.mark.parametrize("shape", [(0, 42, 3), (3, 0, 3), (0, 3)])
def test_no_point_is_refused(shape):
    refused(errors.DegenerateMeshError, "points are empty", np.zeros(shape))


def test_no_face_is_refused():
    refused(errors.DegenerateMeshError, "there are no faces", faces=np.zeros((0, 3), int))


def test_faces_that_use_a_vertex_twice_only_are_refused():
    refused(errors.DegenerateMeshError, "none of the 2 faces", faces=np.array([[0, 1, 1], [2, 2, 2]]))


def test_mesh_without_extent_is_refused():
    refused(errors.DegenerateMeshError, "no extent.* diagonal is 0", np.full_like(FRAMES, 3.0))


def test_mesh_without_extent_but_for_a_vertex_without_a_face_is_refused():
    points = np.concatenate([np.zeros_like(POINTS), [[1, 1, 1]]]).astype(np.float32)
    refused(errors.DegenerateMeshError, "no extent", points)


def test_missing_faces_are_named():
    refused(errors.OptionError, "faces .* missing", faces=None)


def test_faces_beside_a_trimesh_are_refused():
    refused(errors.OptionError, "must not be given with a trimesh", trimesh.Trimesh(POINTS, FACES), FACES)


@pytest.mark.parametrize("ratio", [0, -0.1, 1.5, float("nan"), float("inf")])
def test_ratio_out_of_range_is_refused(ratio):
    refused(errors.OptionError, rf"ratio must be in \(0, 1\], got {ratio}", ratio=ratio)


@pytest.mark.parametrize("target", [0, -3, 2.5, float("nan"), float("inf")])
def test_target_that_is_no_face_count_is_refused(target):
    refused(errors.OptionError, rf"target_faces .* got {target}", ratio=None, target_faces=target)


@pytest.mark.parametrize("limit", [0, -1, float("nan"), float("inf")])
def test_max_error_out_of_range_is_refused(limit):
    refused(errors.OptionError, rf"max_error .* got {limit}", ratio=None, max_error=limit)


def test_no_goal_is_refused():
    refused(errors.OptionError, "one of ratio, target_faces, max_error and max_distance", ratio=None)


def test_two_counts_are_refused():
    refused(errors.OptionError, "ratio 0.5 and target_faces 10 exclude each other", target_faces=10)


@pytest.mark.parametrize("coherence", [-0.1, 1.1, float("nan")])
def test_coherence_out_of_range_is_refused(coherence):
    refused(errors.OptionError, rf"coherence must be in \[0, 1\], got {coherence}", coherence=coherence)


@pytest.mark.parametrize("key_frames", [0, -1, 1.5, float("nan")])
def test_key_frames_out_of_range_are_refused(key_frames):
    refused(errors.OptionError, rf"key_frames .* got {key_frames}", key_frames=key_frames)


def test_unknown_placement_is_refused():
    refused(errors.OptionError, "placement must be 'optimal' or 'endpoint', got 'middle'", placement="middle")


def test_unknown_metric_is_refused_with_the_list_of_known_ones():
    refused(errors.OptionError, "unknown metric 'volume'; there are qem, dsd, dod, aqem", metric="volume")


@pytest.mark.parametrize("device", ["cuda:99", "tpu", ""])
def test_unknown_device_is_refused_with_the_list_of_existing_ones(device):
    refused(errors.DeviceError, rf"no Warp device '{device}' on this machine; it has: .*cpu", device=device)


def test_negative_vertex_weight_is_named():
    weights = changed(np.ones(42), 9, -2)
    expected = r"vertex_weights must be in \[0, 1e\+12\], got -2.0 at vertex 9"
    refused(errors.OptionError, expected, vertex_weights=weights)


@pytest.mark.parametrize("value", [np.nan, -np.inf])
def test_vertex_weight_that_is_not_finite_is_named(value):
    refused(
        errors.MeshShapeError, f"vertex_weights of vertex 9 is {value}", vertex_weights=changed(np.ones(42), 9, value)
    )


@pytest.mark.parametrize("weights", [np.ones(41), np.ones((42, 1)), np.full(42, "a")])
def test_vertex_weights_of_another_shape_or_dtype_are_refused(weights):
    refused(errors.MeshShapeError, "vertex_weights must be 42 numbers", vertex_weights=weights)


@pytest.mark.parametrize("index", [-1, 42])
def test_locked_index_out_of_range_is_named(index):
    refused(errors.OptionError, rf"locked names vertex {index}, but there are 42", locked=[0, index])


def test_locked_mask_of_another_length_is_refused():
    refused(errors.OptionError, r"locked must have one entry for each of 42 vertices", locked=np.ones(41, bool))


@pytest.mark.parametrize("locked", [[0.5], [[1, 2]], ["a"]])
def test_locked_of_another_shape_or_dtype_is_refused(locked):
    refused(errors.OptionError, "locked must be .* bool or vertex indices", locked=locked)


def test_unreachable_target_names_the_count_reached():
    refused(errors.UnreachableTargetError, "4 faces are left .* 1 were asked for", ratio=None, target_faces=1)


def test_locking_everything_leaves_no_legal_collapse():
    refused(errors.UnreachableTargetError, "80 faces are left .* 40 were asked for", locked=np.ones(42, bool))


@pytest.mark.parametrize("name", [n for n in errors.__all__ if n != "WarpqemError"])
def test_every_error_is_a_warpqem_error(name):
    assert issubclass(getattr(errors, name), errors.WarpqemError)


def test_motion_features_refuse_a_bad_mesh_as_simplify_does():
    with pytest.raises(errors.NonFinitePointError, match="vertex 3 in frame 1"):
        warpqem.motion_features(changed(FRAMES, (1, 3), np.nan), FACES, device="cpu")


def test_unknown_attribute_of_the_package_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'simplifier'"):
        _ = warpqem.simplifier
