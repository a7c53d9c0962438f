"""Work goes to the device that is named, never to the one that Warp takes by itself."""

import pytest
import warp as wp
from warp._src import context

import warpqem
from tests.support import meshes


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
