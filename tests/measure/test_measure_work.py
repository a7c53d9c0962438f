"""How much measuring has to do: what is known is not looked for again."""

import subprocess
import sys

import numpy as np
import warp as wp

from tests.support.usd_stages import cloth_stage
from warpqem.measure import compare, largest


def travelling_waves(side: int, frame_count: int):
    """A sheet over which a wave travels, (F, V, 3), and its faces (N, 3)."""
    x, y = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    frame = np.arange(frame_count)[:, None, None]
    height = 0.1 * np.sin(6 * x + 0.11 * frame) + 0.05 * np.sin(9 * y - 0.07 * frame + 3 * x)
    points = np.stack([np.broadcast_to(x, height.shape), np.broadcast_to(y, height.shape), height], axis=-1)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, side], corner[:, None] + [1, side + 1, side]])
    return points.reshape(frame_count, -1, 3).astype(np.float32), faces.astype(np.int32)


def test_few_patches_of_a_frame_are_searched_where_the_largest_distance_wanders(monkeypatch):
    (fine, faces), (coarse, coarse_faces) = travelling_waves(15, 256), travelling_waves(8, 256)
    searched, search = [], largest.search_patches

    def counted(own, other, patches, *arguments, **options):
        searched.append(len(patches))
        return search(own, other, patches, *arguments, **options)

    monkeypatch.setattr(largest, "search_patches", counted)
    compare(fine, faces, coarse, coarse_faces, device="cpu")
    # Those that may hold more than the samples show are three times as many.
    assert sum(searched) / 256 <= 80


def test_hierarchy_of_a_key_frame_is_built_once(monkeypatch):
    # Both sides of a thin sheet: the nearest face is mostly on the wrong one, so that faces are searched twice.
    (fine, faces), (coarse, coarse_faces) = travelling_waves(15, 8), travelling_waves(6, 8)
    meshes = []
    for points, triangles in ((fine, faces), (coarse, coarse_faces)):
        both = np.concatenate([points, points + np.float32([0, 0, 1e-3])], axis=1)
        meshes += [both, np.concatenate([triangles[:, ::-1], triangles + points.shape[1]])]
    built, facing = [], []
    monkeypatch.setattr("warpqem.measure.closest_points.wp", wp_with(built))
    monkeypatch.setattr("warpqem.measure.binding_surface.wp", wp_with(facing))
    compare(*meshes, device="cpu")
    # Eight key frames to bind in, and eight frames of jitter.
    assert (len(built), len(facing)) == (16, 0)


def wp_with(built):
    """Warp with a mesh that notes that it is built."""

    class Counted(wp.Mesh):
        def __init__(self, *arguments, **options):
            built.append(self)
            super().__init__(*arguments, **options)

    class Warp:
        Mesh = Counted

        def __getattr__(self, name):
            return getattr(wp, name)

    return Warp()


def test_comparison_of_two_files_loads_nothing_that_simplifies_or_writes(tmp_path):
    cloth = tmp_path / "cloth.usda"
    cloth_stage(cloth)
    code = (
        f"import sys; sys.argv = ['warpqem', 'compare', {str(cloth)!r}, {str(cloth)!r}, '--device', 'cpu']\n"
        "from warpqem.cli.main import app\n"
        "try:\n    app()\nexcept SystemExit as stop:\n    assert stop.code == 0\n"
        "rooms = ('decimation.decimate', 'place.place', 'refit', 'skinning', 'face', 'report', 'usd.write.write')\n"
        "loaded = [room for room in rooms if f'warpqem.{room}' in sys.modules]\n"
        "assert not loaded, loaded"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
