"""Results in Python: one line each, no comparison of arrays, a picture in a notebook."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import io
import pickle

import numpy as np
import pytest
from PIL import Image

import warpqem
from tests.support import meshes
from warpqem.arguments.array_record import ArrayRecord, brief
from warpqem.picture import fit_view
from warpqem.picture.preview import preview

POINTS, FACES = meshes.swaying_sphere(2, 5)
ROOMS = ("warpqem", *(f"warpqem.{room}" for room in warpqem._ROOMS))
ARRAYS = ("ndarray", "NDArray", "ArrayInput", "wp.array")


def public_dataclasses() -> list[type]:
    found = {getattr(module, name) for module in map(importlib.import_module, ROOMS) for name in module.__all__}
    return sorted((kind for kind in found if inspect.isclass(kind) and dataclasses.is_dataclass(kind)), key=str)


def holds_arrays(kind: type) -> bool:
    # What only takes or gives arrays, such as a function, holds none.
    types = [str(entry.type) for entry in dataclasses.fields(kind)]
    return any(name in text and "Callable" not in text for text in types for name in ARRAYS)


RESULTS = {
    "simplified": lambda: warpqem.simplify(POINTS, FACES, ratio=0.3, device="cpu"),
    "level": lambda: warpqem.build_progressive(POINTS, FACES, device="cpu").level(faces=100),
    "progressive": lambda: warpqem.build_progressive(POINTS, FACES, device="cpu"),
    "order": lambda: warpqem.order_levels(POINTS, FACES, target_faces=60, device="cpu"),
    "features": lambda: warpqem.motion_features(POINTS, FACES, device="cpu"),
    "view": lambda: fit_view(POINTS),
}


@pytest.mark.parametrize("kind", public_dataclasses(), ids=lambda kind: kind.__name__)
def test_public_classes_with_arrays_equal_themselves_alone(kind):
    if holds_arrays(kind):
        assert issubclass(kind, ArrayRecord)
        assert kind.__eq__ is object.__eq__
        assert kind.__hash__ is object.__hash__


def test_classes_with_arrays_are_found():
    names = {kind.__name__ for kind in public_dataclasses() if holds_arrays(kind)}
    assert {"SimplifiedMesh", "MeshSequence", "FacialFeatures", "FrameErrors", "LinearSkin", "Report"} <= names


@pytest.mark.parametrize("name", RESULTS)
def test_results_are_shown_in_one_line(name):
    text = repr(RESULTS[name]())
    assert "\n" not in text
    assert len(text) < 200
    assert "array(" not in text


def test_the_line_of_a_result_says_its_size_and_why_it_stopped():
    result = RESULTS["simplified"]()
    assert repr(result).startswith("SimplifiedMesh(96 faces, 50 vertices, 5 frames, stopped='target', estimate=")
    assert repr(RESULTS["progressive"]()) == "ProgressiveMesh(4 to 320 faces, 5 frames)"


def test_results_can_be_compared_and_kept_in_sets():
    result = RESULTS["simplified"]()
    other = dataclasses.replace(result)
    assert (result == result, result == other, result != other) == (True, False, True)
    assert len({result, other}) == 2


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Record(ArrayRecord):
    points: np.ndarray
    names: tuple[str, ...]
    parts: list[np.ndarray]
    text: str = dataclasses.field(default="", repr=False)


def test_arrays_are_shown_by_dtype_and_shape_and_long_values_by_their_number():
    record = Record(np.zeros((2, 3), np.float32), ("nose",) * 50, [np.zeros(2)] * 3, "hidden")
    assert repr(record) == "Record(points=float32 (2, 3), names=tuple of 50, parts=list of 3)"
    assert brief(np.float64(2.0)) == repr(np.float64(2.0))
    assert brief("a\nb" * 60).endswith("...")
    assert len(brief("x" * 1000)) == 60
    assert repr(pickle.loads(pickle.dumps(record))) == repr(record)


@pytest.mark.parametrize("name", ["simplified", "level", "progressive"])
def test_a_notebook_shows_a_picture_of_a_result(name):
    with Image.open(io.BytesIO(RESULTS[name]()._repr_png_())) as picture:
        assert picture.format == "PNG"
        assert picture.size == (900, 251)
        columns = np.asarray(picture.convert("L")).std(axis=0).reshape(3, 300)
    # The mesh is in each of the three pictures.
    assert (columns.max(axis=1) > 10).all()


def test_one_pose_is_shown_from_three_sides_and_two_frames_once_each():
    cone = POINTS[0] * np.linspace(1, 3, len(POINTS[0]))[:, None].astype(np.float32)
    pictures = {}
    for count in (1, 2):
        with Image.open(io.BytesIO(preview(np.stack([cone] * count), FACES))) as picture:
            pictures[count] = np.asarray(picture.convert("L"))
    assert pictures[2].shape == (251, 600)
    sides = pictures[1].reshape(225, 3, 300).transpose(1, 0, 2)
    assert not np.array_equal(sides[0], sides[1])
    assert not np.array_equal(sides[0], sides[2])


@pytest.mark.parametrize(
    ("asked", "same"),
    [
        ({"faces": 100}, {"target_faces": 100}),
        ({"ratio": 0.4}, {"ratio": 0.4}),
        ({"max_error": 3.0}, {"max_error": 3.0}),
        ({"max_size_error": 3.0}, {"max_size_error": 3.0}),
    ],
)
def test_a_level_is_named_by_faces_ratio_or_error(asked, same):
    mesh = RESULTS["progressive"]()
    level, expected = mesh.level(**asked), mesh.level(mesh.splits_for(**same))
    assert level.split_count == expected.split_count
    assert np.array_equal(level.points, expected.points)
    assert np.array_equal(level.faces, expected.faces)


@pytest.mark.parametrize("asked", [{}, {"faces": 100, "ratio": 0.5}, {"split_count": 3, "faces": 100}])
def test_a_level_is_named_by_exactly_one_argument(asked):
    with pytest.raises(
        warpqem.errors.OptionError, match="exactly one of split_count, faces, ratio, max_error and max_size_error"
    ):
        RESULTS["progressive"]().level(**asked)
