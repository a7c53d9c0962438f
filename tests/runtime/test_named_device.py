"""Work goes to the device that is named, never to the one that Warp takes by itself."""

import ast
import re
from pathlib import Path

import pytest
import warp as wp
from warp._src import context

import warpqem
from tests.support import meshes


def devices_named_in(path: Path) -> list[str]:
    """The GPUs that code names, and not its docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    constants = [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in docs]
    return [
        node.value for node in constants if isinstance(node.value, str) and re.fullmatch(r"cuda(:\d+)?", node.value)
    ]


def test_no_room_but_that_of_devices_names_a_gpu():
    package = Path(warpqem.__file__).parent
    naming = {str(path.relative_to(package)) for path in package.rglob("*.py") if devices_named_in(path)}
    assert naming == {"runtime/device.py"}


@pytest.fixture
def no_other_device(monkeypatch):
    """Makes it an error to leave the device to Warp."""
    runtime = type(context.runtime)
    named = runtime.get_device

    def get_device(self, ident=None):
        assert ident is not None, "no device is named"
        return named(self, ident)

    monkeypatch.setattr(runtime, "get_device", get_device)


def test_leaving_the_device_to_warp_is_seen(no_other_device):
    with pytest.raises(AssertionError, match="no device is named"):
        wp.zeros(3, dtype=wp.int32)


@pytest.mark.parametrize(
    "options",
    [{"quality": "best"}, {"quality": "fast", "metric": "dod"}, {"quality": "fast", "max_error": 1.0}],
    ids=str,
)
def test_everything_is_on_the_device_that_is_named(options, no_other_device, device):
    points, faces = meshes.swaying_sphere(3, 4)
    warpqem.simplify(points, faces, ratio=0.3, device=device, **options)
