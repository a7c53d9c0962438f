"""Options of a simplification from names and text."""

from __future__ import annotations

import inspect

import pytest

from warpqem.arguments.option_fields import named_options
from warpqem.cli.batch import batch
from warpqem.cli.simplify import simplify
from warpqem.costs.motion_features import MotionWeighting
from warpqem.costs.screen_error import ScreenView
from warpqem.errors import OptionError
from warpqem.usd import FrameRange, SimplifyOptions
from warpqem.usd.commands.option_values import override_options, read_options

TEXT = {
    "faces": "40", "metric": "dod", "coherence": "0.2", "refit": "yes", "key-frames": "4", "uv_weight": "1",
    "attribute-weight": "st=1 map2=0.5", "memory": "2G", "frames": "1:9:2", "prim": "/A /B", "weld": "false",
    "feature-threshold": "3", "feature-weight": "log",
}  # fmt: skip
VALUES = {
    "faces": 40, "metric": "dod", "coherence": 0.2, "refit": True, "key_frames": 4, "uv_weight": 1.0,
    "attribute_weight": ["st=1", "map2=0.5"], "memory": "2G", "frames": "1:9:2", "prim": ["/A", "/B"], "weld": False,
    "feature_threshold": 3.0, "feature_weight": "log",
}  # fmt: skip


@pytest.mark.parametrize("values", [TEXT, VALUES], ids=["text", "values"])
def test_options_come_from_text_and_from_values(values):
    assert read_options(values) == SimplifyOptions(
        faces=40, metric="dod", coherence=0.2, refit=True, key_frames=4, uv_weight=1.0,
        attribute_weights=(("st", 1.0), ("map2", 0.5)), memory="2G", frames=FrameRange(1, 9, 2), prims=("/A", "/B"),
        weld=False, feature_threshold=3.0, feature_weight="log",
    )  # fmt: skip


def parameters(command):
    return inspect.signature(command).parameters


def test_commands_take_every_option():
    names = set(named_options(SimplifyOptions))
    assert names <= set(parameters(simplify))
    assert names <= set(parameters(batch))


def test_defaults_of_the_command_line_are_those_of_the_options():
    taken = parameters(simplify)
    values = {name: taken[name].default for name in named_options(SimplifyOptions)}
    assert read_options({**values, "ratio": 0.5}) == SimplifyOptions(ratio=0.5)


def test_a_view_is_read_from_its_parts():
    options = read_options({"screen_error": 2, "distance": "10", "fov": "30"})
    assert options.screen == ScreenView(2.0, 10.0, 30.0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"rotio": 1}, "no option 'rotio'; there are .*ratio"),
        ({"ratio": "half"}, r"ratio must be in \(0, 1\], got 'half'"),
        ({"faces": 2.5}, "faces 2.5: expected a whole number"),
        ({"ratio": 0.5, "weld": "perhaps"}, "weld 'perhaps': expected true or false"),
        ({"ratio": True}, r"ratio must be in \(0, 1\], got True"),
        ({"ratio": 0.5, "metric": 3}, "metric 3: expected text"),
        ({"ratio": 0.5, "prim": [3]}, "prim"),
        ({"lods": ""}, "lods"),
        ({"ratio": "0_1"}, r"ratio must be in \(0, 1\], got '0_1'; give 1"),
        ({"max_error": "\u0663"}, "max_error must be a finite number above 0, got '\u0663'; give 3"),
        ({"faces": "\u0663\u0660"}, "expected a whole number.*; give 30"),
        ({"lods": "0.5,0.2_5"}, "'0.2_5' is no number.*; give 0.25"),
        ({"ratio": 0.5, "memory": "\u0663G"}, "expected bytes above 0"),
        ({"max_distance": "\u0663mm"}, "expected a length"),
        ({"ratio": 0.5, "frames": "1:1_0"}, "START, END and STEP must be numbers"),
        ({"ratio": 0.5, "attribute_weight": "st=1_0"}, "expected NAME=WEIGHT"),
        ({"ratio": 0.5, "influences": "\u0664"}, "expected a whole number"),
        ({"screen_error": 2}, "screen_error needs distance"),
        ({"ratio": 0.5, "distance": 2}, "distance needs screen_error"),
        ({}, "one of ratio, faces, max_error, max_distance, screen and lods is needed"),
        ({"ratio": 0.5, "faces": 4, "max_error": 1}, "ratio 0.5 and faces 4 exclude each other"),
        ({"max_error": 1, "lods": "0.5"}, "lods and max_error exclude each other"),
    ],
)
def test_wrong_values_are_named(values, message):
    with pytest.raises(OptionError, match=message):
        read_options(values)


def test_ratio_that_is_no_number_is_refused():
    with pytest.raises(OptionError, match=r"ratio must be in \(0, 1\], got '0.5'"):
        SimplifyOptions(ratio="0.5")


def test_a_goal_takes_the_place_of_another():
    merged = override_options({"screen_error": 1.0, "distance": 5.0, "refit": True}, {"max-error": 2, "ratio": ""})
    assert read_options(merged) == SimplifyOptions(max_error=2.0, refit=True)


def test_options_of_motion_features_are_one_for_the_core_and_none_where_nothing_is_asked():
    asked = read_options({"ratio": 0.1, "metric": "aqem", "feature_floor": "0.5", "feature_weight": "bend"})
    assert asked.motion == MotionWeighting(floor=0.5, weight="bend")
    assert read_options({"ratio": 0.1}).motion is None


def test_threshold_of_motion_features_that_is_no_angle_is_refused():
    with pytest.raises(OptionError, match=r"feature_threshold must be in \[0, 180\], got 200"):
        read_options({"ratio": 0.1, "feature-threshold": "200"})
