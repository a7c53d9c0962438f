"""Numbers, flags, names and objects of the wrong type: refused by name, wherever they are given."""

from __future__ import annotations

import functools
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

import warpqem
from tests.support import meshes
from warpqem.arguments.number_input import flag, real_number, whole_number
from warpqem.costs.screen_error import ScreenView
from warpqem.errors import DeviceError, MeshShapeError, OptionError
from warpqem.face import FaceProtection, FacialFeatures, facial_features
from warpqem.measure import compare, distance_colors
from warpqem.picture import View, fit_view, render
from warpqem.pipeline.mirror import MirrorPlane, find_mirror
from warpqem.pipeline.surface_transfer import surface_transfer
from warpqem.progressive import load, save
from warpqem.skinning.fit_skin import fit_skin
from warpqem.usd import SimplifyOptions

POINTS, FACES = meshes.swaying_sphere(1, 3)
NO_NUMBERS = [
    "0.5",
    b"0.5",
    True,
    np.True_,
    None,
    float("nan"),
    [0.5],
    1 + 0j,
    Decimal("0.5"),
    np.array([0.5]),
    object(),
]
NO_FLAGS = ["yes", "no", "", None, 2, 0.0, [], np.array([True])]
NO_FUNCTIONS = [3, "print", []]

simplify = functools.partial(warpqem.simplify, POINTS, FACES)


def order(**options: Any) -> Any:
    return warpqem.order_levels(POINTS, FACES, **{"target_faces": 60, "device": "cpu", **options})


@functools.cache
def one_order() -> warpqem.LevelOrder:
    return order()


@functools.cache
def progressive() -> warpqem.ProgressiveMesh:
    return warpqem.build_progressive(POINTS, FACES, base_faces=60, device="cpu")


def calls(name: str, function: Any, **fixed: Any) -> Any:
    return lambda value: function(**{**fixed, name: value})


def measured(name: str) -> Any:
    return calls(name, functools.partial(compare, POINTS, FACES, POINTS, FACES, device="cpu"))


def level(name: str) -> Any:
    return lambda value: one_order().level(**{"target_faces": 70, name: value})


# Arguments that are numbers: what is no number, and numbers outside their range.
NUMBERS: dict[str, tuple[Any, list[Any]]] = {
    "ratio": (calls("ratio", simplify, max_error=1.0), [0, -1, 1.1, np.inf]),
    "target_faces": (calls("target_faces", simplify, max_error=1.0), [0, -5, 2.5, np.inf, np.float32(0.5)]),
    "max_error": (calls("max_error", simplify, ratio=0.5), [0, -1, np.inf]),
    "coherence": (calls("coherence", simplify, ratio=0.5), [-0.1, 1.1, np.inf]),
    "key_frames": (calls("key_frames", simplify, ratio=0.5), [0, -1, 1.5, np.inf]),
    "plan ratio": (calls("ratio", functools.partial(warpqem.plan, POINTS, FACES), max_error=1.0), [0, np.inf]),
    "attribute weight": (
        lambda value: simplify(ratio=0.5, attributes=[warpqem.costs.AttributeField(np.ones(42), value)]),
        [-1, np.inf, 1e7],
    ),
    "ratios": (lambda value: warpqem.simplify_levels(POINTS, FACES, ratios=[value]), [0, 2]),
    "order target_faces": (calls("target_faces", order), [0, -1, 0.5]),
    "level target_faces": (level("target_faces"), [0, -1, 70.5, 59, np.inf]),
    "base_faces": (calls("base_faces", functools.partial(warpqem.build_progressive, POINTS, FACES)), [0, -1, 1.5]),
    "splits_for ratio": (lambda value: progressive().splits_for(ratio=value, target_faces=None), [0, -1, 2]),
    "splits_for target_faces": (lambda value: progressive().splits_for(target_faces=value), [0, -1, 70.5]),
    "splits_for max_error": (lambda value: progressive().splits_for(max_error=value), [-1, 0, np.inf]),
    "splits_for max_size_error": (lambda value: progressive().splits_for(max_size_error=value), [-1, 0, np.inf]),
    "level of a progressive mesh": (lambda value: progressive().level(value), [-1, 0.5, 10**9]),
    "vertex_map": (lambda value: progressive().vertex_map(value), [-1, 0.5, 10**9]),
    "error of a level": (lambda value: progressive().error(value), [-1, 0.5, 10**9]),
    "morph coarse": (lambda value: progressive().morph(value, 2, 0.5), [-1, 0.5]),
    "morph fine": (lambda value: progressive().morph(0, value, 0.5), [-1, 0.5]),
    "morph blend": (lambda value: progressive().morph(0, 1, value), [-0.1, 1.1]),
    "samples": (measured("samples"), [0, -1, 1.5]),
    "seed": (measured("seed"), [-1, 1.5]),
    "scale": (calls("scale", functools.partial(distance_colors, POINTS, FACES, POINTS, FACES)), [0, -1, np.inf]),
    "screen error": (lambda value: ScreenView(value, 1.0), [0, -1, np.inf]),
    "screen distance": (lambda value: ScreenView(1.0, value), [0, -1, np.inf]),
    "field of view": (lambda value: ScreenView(1.0, 1.0, value), [0, 180, -1]),
    "image height": (lambda value: ScreenView(1.0, 1.0, 45.0, value), [0, -1]),
    "face weight": (lambda value: FaceProtection(weight=value), [0.5, np.inf]),
    "face ring": (lambda value: FaceProtection(ring=value), [-1, 0.5]),
    "plane offset": (lambda value: find_mirror(POINTS[0], FACES, MirrorPlane(np.eye(3)[0], value)), [np.inf]),
    "azimuth": (lambda value: View(value, 0.0, (0, 0, 0), 1.0), [np.inf]),
    "height of the view": (lambda value: View(0.0, 0.0, (0, 0, 0), value), [0, -1, np.inf]),
    "aspect": (lambda value: fit_view(POINTS, aspect=value), [0, -1, np.inf]),
    "width of the picture": (lambda value: render(POINTS[0], FACES, fit_view(POINTS), size=(value, 8)), [0, 1.5]),
}
MAY_BE_NONE = {
    "ratio", "target_faces", "max_error", "key_frames", "base_faces", "scale", "plan ratio", "samples"
}  # fmt: skip
FLAGS = {
    "refit": calls("refit", simplify, ratio=0.5),
    "memoryless": calls("memoryless", simplify, ratio=0.5),
    "lock_borders": calls("lock_borders", simplify, ratio=0.5),
    "keep_components": calls("keep_components", simplify, ratio=0.5),
    "plan levels": calls("levels", functools.partial(warpqem.plan, POINTS, FACES), ratio=0.5),
    "keep_frames": calls("keep_frames", order),
    "levels refit": calls("refit", functools.partial(warpqem.simplify_levels, POINTS, FACES), ratios=[0.5]),
    "face keep": lambda value: FaceProtection(keep=value),
    "resume": lambda value: warpqem.batch([], resume=value),
}
FUNCTIONS = {
    "simplify progress": calls("progress", simplify, ratio=0.5),
    "order progress": calls("progress", order),
    "level progress": level("progress"),
    "compare progress": measured("progress"),
    "symmetric progress": calls("progress", functools.partial(warpqem.simplify_symmetric, POINTS, FACES), ratio=0.5),
    "on_update": lambda value: warpqem.batch([], on_update=value),
}
JOB = warpqem.BatchJob("in.usda", "out.usda", SimplifyOptions(ratio=0.5))
# Other arguments, each with what is refused and what the message says.
OTHERS: list[tuple[Any, Any, str]] = [
    (calls("metric", simplify, ratio=0.5), ["dsd"], r"metric must be the name .*, got \['dsd'\] \(list\)"),
    (calls("metric", simplify, ratio=0.5), None, "metric must be the name"),
    (calls("placement", simplify, ratio=0.5), np.array(["optimal"]), "placement must be 'optimal' or 'endpoint'"),
    (calls("attributes", simplify, ratio=0.5), warpqem.costs.AttributeField(np.ones(42)), "attributes must be a list"),
    (
        calls("attributes", simplify, ratio=0.5),
        (warpqem.costs.AttributeField(np.ones(42)) for _ in range(1)),
        r"attributes must be a list of AttributeField, got .*\(generator\)",
    ),
    (calls("attributes", simplify, ratio=0.5), [np.ones(42)], r"attributes\[0\] must be an AttributeField"),
    (calls("attributes", simplify, ratio=0.5), None, "attributes must be a list"),
    (calls("memory", simplify, ratio=0.5), True, "memory True: expected bytes"),
    (calls("memory", simplify, ratio=0.5), b"8G", "expected bytes"),
    (calls("memory", simplify, ratio=0.5), float("nan"), "expected bytes"),
    (calls("face", simplify, ratio=0.5, metric="face"), "auto", "face must be a FaceProtection"),
    (lambda value: warpqem.simplify_levels(POINTS, FACES, ratios=value), "0.5", "ratios must be a list of numbers"),
    (lambda value: warpqem.simplify_levels(POINTS, FACES, ratios=value), 0.5, "ratios must be a list of numbers"),
    (lambda value: warpqem.simplify_levels(POINTS, FACES, ratios=value), (r for r in ()), "need ratios"),
    (measured("frames"), slice(0, 2), "frames: expected None, a number or a list of frame indices, got slice"),
    (measured("frames"), "0:2", "frames: expected None, a number"),
    (measured("frames"), True, "frames: expected None, a number"),
    (measured("frames"), [0, 1.5], "frames: expected None, a number"),
    (measured("frames"), [[0], [1, 2]], "frames: expected None, a number"),
    (measured("frames"), np.ma.MaskedArray([0, 1], [True, False]), "frames: expected None.*masked"),
    (measured("frames"), [0, 2**32], "names a frame outside"),
    (lambda value: facial_features(POINTS, FACES, overrides=value), ["nose_tip"], "overrides must map names"),
    (lambda value: facial_features(POINTS, FACES, overrides={"nose_tip": value}), True, "nose_tip: vertex True"),
    (lambda value: facial_features(POINTS, FACES, overrides={"nose_tip": value}), 1.0, "nose_tip: vertex 1.0"),
    (lambda value: FaceProtection(features=value), {}, "features must be FacialFeatures"),
    (lambda value: warpqem.face.retarget(value, value, POINTS), (POINTS, FACES), "source must be a FaceMesh"),
    (lambda value: warpqem.costs.morph_weights(POINTS[0], POINTS, value), 3, "method must be one of thirds, rank"),
    (lambda value: warpqem.costs.morph_weights(POINTS[0], POINTS, value), None, "method must be one of thirds, rank"),
    (lambda value: find_mirror(POINTS[0], FACES, value), 3, "symmetry must be auto, x, y, z or a MirrorPlane, got 3"),
    (lambda value: find_mirror(POINTS[0], FACES, MirrorPlane(value, 0.0)), np.array([2.0, 0, 0]), "must have length 1"),
    (lambda value: surface_transfer(POINTS[0], FACES, value), (POINTS, FACES), "result must be a SimplifiedMesh"),
    (lambda value: fit_skin(POINTS, FACES, value, None, None), None, "result must be a SimplifiedMesh"),
    (lambda value: render(POINTS[0], FACES, value), None, "view must be a View"),
    (lambda value: render(POINTS[0], FACES, fit_view(POINTS), size=value), 8, "size must be width and height"),
    (lambda value: fit_view(POINTS, up=value), ["y"], "up axis"),
    (lambda value: save(value, "never.wqpm"), POINTS, "mesh must be a ProgressiveMesh"),
    (lambda value: load("never.wqpm", target_faces=value), "3", "target_faces must be a whole number"),
    (lambda value: load("never.wqpm", split_count=value), 1.5, "split_count must be a whole number"),
    (lambda value: warpqem.batch(value), "in.usda", "jobs must be a list of BatchJob"),
    (lambda value: warpqem.batch(value), 3, "jobs must be a list of BatchJob"),
    (lambda value: warpqem.batch(value), [("in.usda", "out.usda")], r"jobs\[0\] must be a BatchJob"),
    (lambda value: warpqem.batch([JOB, value]), warpqem.BatchJob(3, "o.usda", JOB.options), r"jobs\[1\]\.input must"),
    (lambda value: warpqem.batch(value), [warpqem.BatchJob("i.usda", "o.usda", {})], r"jobs\[0\]\.options must be"),
    (lambda value: warpqem.batch([JOB], value), 3, "engine must be local, ray or an object"),
    (lambda value: warpqem.batch([JOB], journal=value), 3, "journal must be a path"),
]  # fmt: skip


@pytest.mark.parametrize("name", NUMBERS)
def test_what_is_no_number_of_the_range_is_refused(name):
    call, outside = NUMBERS[name]
    for value in [*NO_NUMBERS, *outside]:
        if value is None and name in MAY_BE_NONE:
            continue
        with pytest.raises(OptionError, match=r"got|asked for|is needed"):
            call(value)


# None leaves them to the quality.
FLAGS_OR_NONE = {"refit", "memoryless", "levels refit"}


@pytest.mark.parametrize("name", FLAGS)
def test_what_is_neither_true_nor_false_is_refused(name):
    for value in NO_FLAGS:
        if value is None and name in FLAGS_OR_NONE:
            continue
        with pytest.raises(OptionError, match="must be True or False, got"):
            FLAGS[name](value)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_cannot_be_called_is_refused(name):
    for value in NO_FUNCTIONS:
        with pytest.raises(OptionError, match=r"must be a function(, True for a bar,)? or None, got"):
            FUNCTIONS[name](value)


@pytest.mark.parametrize(("call", "value", "message"), OTHERS)
def test_other_arguments_of_the_wrong_type_are_named(call, value, message):
    with pytest.raises(OptionError, match=message):
        call(value)


@pytest.mark.parametrize("device", [3, True, b"cpu", ["cpu"], 1.5, object(), "CPU", np.array("cpu")])
def test_devices_of_the_wrong_type_are_named(device):
    for call in (simplify, functools.partial(warpqem.plan, POINTS, FACES)):
        with pytest.raises(DeviceError, match=r"no Warp device .* it has: "):
            call(ratio=0.5, device=device)


@pytest.mark.parametrize("device", [wp.get_device("cpu"), np.str_("cpu")])
def test_a_device_may_be_given_as_one(device):
    assert warpqem.plan(POINTS, FACES, ratio=0.5, device=device).face_count == 80


@pytest.mark.parametrize(
    "value", [0.5, np.float32(0.5), np.float16(0.5), Fraction(1, 2), np.array(0.5), np.longdouble(0.5)]
)
def test_numbers_of_any_type_serve(value):
    np.testing.assert_array_equal(simplify(ratio=value, device="cpu").faces, simplify(ratio=0.5, device="cpu").faces)


@pytest.mark.parametrize("value", [40, 40.0, np.int8(40), np.uint64(40), np.float32(40), np.array(40), Fraction(40)])
def test_whole_numbers_of_any_type_serve(value):
    assert len(simplify(target_faces=value, key_frames=np.int64(2), device="cpu").faces) == 40


@pytest.mark.parametrize("value", [1, np.True_, np.int64(1)])
def test_flags_of_any_type_serve(value):
    np.testing.assert_array_equal(
        simplify(ratio=0.5, refit=value, device="cpu").points, simplify(ratio=0.5, refit=True, device="cpu").points
    )


def test_a_masked_weight_in_a_list_is_refused():
    with pytest.raises(MeshShapeError, match="1 masked values, the first at index 41"):
        simplify(ratio=0.5, vertex_weights=[*[1.0] * 41, np.ma.masked])


@pytest.mark.parametrize("vertex", [-1, 42, 10**6])
def test_a_feature_point_that_is_no_vertex_is_named(vertex):
    features = FacialFeatures({"nose_tip": vertex}, {"nose_tip": 1.0}, {}, np.eye(3))
    with pytest.raises(OptionError, match=f"the feature point nose_tip is vertex {vertex}, but there are 42"):
        simplify(ratio=0.5, metric="face", face=FaceProtection(features=features))


def test_attributes_at_vertices_serve_a_symmetric_mesh():
    points, faces = meshes.octahedron()
    for attributes in ([warpqem.costs.AttributeField(points)], [warpqem.costs.AttributeField(points[faces])]):
        result = warpqem.simplify_symmetric(points, faces, ratio=1.0, attributes=attributes, device="cpu")
        assert len(result.faces) == 8


def test_a_mirror_of_another_mesh_is_refused():
    mirror = find_mirror(*meshes.octahedron())
    with pytest.raises(OptionError, match="the mirror is one of 6 vertices and 8 faces, the mesh has 42 and 80"):
        warpqem.simplify_symmetric(POINTS, FACES, mirror, ratio=0.5)


def test_a_mirror_found_with_faces_that_use_a_vertex_twice_serves():
    points, faces = meshes.octahedron()
    more = np.insert(faces, [0, 3], [[2, 2, 4], [3, 3, 5]], axis=0)
    plain = warpqem.simplify_symmetric(points, faces, "x", ratio=1.0, device="cpu")
    result = warpqem.simplify_symmetric(points, more, find_mirror(points, faces, "x"), ratio=1.0, device="cpu")
    np.testing.assert_array_equal(result.faces, plain.faces)


def test_a_transfer_is_not_made_for_a_result_of_other_faces():
    result = simplify(ratio=0.5, device="cpu")
    with pytest.raises(MeshShapeError, match=r"its face \d+ does not go on from face \d+ of this one"):
        surface_transfer(POINTS[0], FACES[::-1].copy(), result, device="cpu")
    with pytest.raises(MeshShapeError, match="a mesh with 42 vertices"):
        surface_transfer(POINTS[0][:41], FACES[(FACES < 41).all(axis=1)], result, device="cpu")


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_numbers_come_through_as_they_are(value):
    assert repr(real_number(np.float64(value), "x", "any", lambda x: True)) == repr(value)


@given(st.integers(1, 2**80))
def test_whole_numbers_are_not_rounded(value):
    assert whole_number(value, "x") == value


@given(st.booleans() | st.sampled_from([0, 1]))
def test_flags_come_through(value):
    assert flag(value, "x") is bool(value)
