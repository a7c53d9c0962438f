"""Pictures of meshes and sheets of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Gf, UsdGeom
from typer.testing import CliRunner

from tests.support import meshes
from tests.support.usd_stages import cloth_stage, define_cloth
from warpqem.cli.main import app
from warpqem.errors import MeshShapeError, OptionError, StageError
from warpqem.picture import View, caption, fit_view, render, tile, write_gif, write_png
from warpqem.picture.look import Look, Part, Texture, plain_look
from warpqem.picture.sheet import STRIP
from warpqem.usd.commands.render import RenderOptions, render_sheet

FRONT = View(0.0, 0.0, (0.0, 0.0, 0.0), 2.0)
TRIANGLE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
FACE = np.array([[0, 1, 2]])


def test_nearer_of_two_triangles_is_seen(device):
    points = np.concatenate([TRIANGLE + np.array([0.0, 0.0, 0.5]), TRIANGLE])
    colors = np.repeat([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], 3, axis=0)
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    red, _, blue = render(points, faces, FRONT, colors=colors, size=(40, 40), device=device)[20, 20]
    assert red > 100
    assert blue == 0


def test_shape_is_where_and_as_large_as_it_is(device):
    picture = render(TRIANGLE, FACE, FRONT, size=(64, 64), device=device)
    covered = (picture != picture[0, 0]).any(axis=2)
    # Half of the square of side 2, point up, its base at the bottom.
    assert covered.mean() == pytest.approx(0.5, abs=0.03)
    assert covered[-2].mean() > 0.9
    assert covered[2].mean() < 0.1


@pytest.mark.parametrize(("up", "top"), [("y", [0, 1, 0]), ("z", [0, 0, 1])])
@pytest.mark.parametrize("azimuth", [0.0, 130.0])
def test_axes_are_a_rotation_with_the_up_axis_upwards(up, top, azimuth):
    axes = View(azimuth, 20.0, (0, 0, 0), 1.0, up).axes()
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    assert axes[0] @ top == pytest.approx(0, abs=1e-12)
    assert axes[1] @ top == pytest.approx(np.cos(np.radians(20)))


@pytest.mark.parametrize(("up", "forward"), [("y", [0, 0, 1]), ("z", [0, -1, 0])])
def test_azimuth_nought_looks_at_the_front(up, forward):
    np.testing.assert_allclose(View(0.0, 0.0, (0, 0, 0), 1.0, up).axes()[2], forward, atol=1e-12)


def test_fitted_view_shows_all_of_the_mesh(device):
    points, faces = meshes.icosphere(2)
    moved = points * 3 + np.array([50, -20, 7])
    picture = render(moved, faces, fit_view(moved, aspect=1.5), size=(90, 60), device=device)
    border = np.concatenate([picture[0], picture[-1], picture[:, 0], picture[:, -1]])
    assert (border == picture[0, 0]).all()
    covered = (picture != picture[0, 0]).any(axis=2).mean()
    assert covered == pytest.approx(np.pi / 4 / 1.5 / 1.06**2, abs=0.04)


def test_lines_darken_the_edges_only(device):
    plain, lined = (render(TRIANGLE, FACE, FRONT, size=(64, 64), lines=on, device=device) for on in (False, True))
    assert (lined[40, 32] == plain[40, 32]).all()
    assert (lined.astype(int) < plain.astype(int) - 20).any()


def test_smooth_shading_has_no_steps(device):
    points, faces = meshes.icosphere(1)
    view = fit_view(points, aspect=1.0)
    flat, smooth = (render(points, faces, view, size=(64, 64), smooth=on, device=device)[16:48, 16:48, 0].astype(int)
                    for on in (False, True))  # fmt: skip
    assert np.abs(np.diff(smooth, axis=1)).max() < np.abs(np.diff(flat, axis=1)).max()


def test_lines_of_fine_meshes_are_fainter(device):
    darker = []
    for level in (1, 4):
        points, faces = meshes.icosphere(level)
        view = fit_view(points, aspect=1.0)
        plain, lined = (
            render(points, faces, view, size=(64, 64), lines=on, smooth=True, device=device).astype(int)
            for on in (False, True)
        )
        darker.append((plain - lined)[16:48, 16:48].max())
    assert darker[0] > 2 * darker[1] > 0


def textured_quad() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    points = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return points, faces, (points[:, :2] + 1)[faces] / 2


@pytest.mark.parametrize("repeats", [True, False])
def test_texture_lies_as_its_coordinates_say(device, repeats):
    points, faces, uvs = textured_quad()
    pixels = np.zeros((2, 2, 3), dtype=np.uint8)
    # Red at the upper left, blue at the lower right.
    pixels[0, 0], pixels[1, 1] = [255, 0, 0], [0, 0, 255]
    texture = Texture(pixels, (repeats, repeats))
    for shift in (0.0, 1.0):
        look = Look(np.zeros(2, dtype=int), [Part("q", 0)], [texture], uvs=uvs + shift)
        drawn = render(points, faces, FRONT, size=(64, 64), look=look, device=device).astype(int)
        colors = drawn[[16, 16, 48, 48], [16, 48, 16, 48]]
        if repeats or shift == 0.0:
            assert colors[0, 0] > 150
            assert colors[3, 2] > 150
            assert colors[1:3].max() < 100
        else:
            # Only what is nearest to it: the upper right.
            assert colors.max() < 60


def test_colours_of_the_look_are_multiplied_with_its_textures(device):
    points, faces, uvs = textured_quad()
    texture = Texture(np.full((1, 1, 3), 255, dtype=np.uint8))
    colors = np.broadcast_to([0.0, 1.0, 0.0], (2, 3, 3))
    look = Look(np.array([0, 1]), [Part("a", 0), Part("b")], [texture], colors, uvs)
    drawn = render(points, faces, FRONT, size=(64, 64), look=look, device=device)
    for row, column in ((48, 40), (16, 20)):
        red, green, blue = drawn[row, column]
        assert (red, blue) == (0, 0)
        assert green > 100


def test_look_of_another_mesh_is_refused(device):
    with pytest.raises(MeshShapeError, match="look: it is of 3 faces, and the mesh has 1"):
        render(TRIANGLE, FACE, FRONT, look=plain_look(3), size=(8, 8), device=device)


def test_picture_is_the_same_on_every_run(device):
    points, faces = meshes.bumpy_sphere(2)
    view = fit_view(points)
    first, second = (render(points, faces, view, size=(50, 40), device=device) for _ in range(2))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("call", [lambda: View(0, 0, (0, 0, 0), 0.0), lambda: View(0, 0, (0, 0, 0), 1.0, "x")])
def test_views_that_show_nothing_are_refused(call):
    with pytest.raises(OptionError, match="expected"):
        call()


def test_tiles_are_laid_out_by_rows():
    sheet = tile([np.full((2, 3, 3), value, dtype=np.uint8) for value in (1, 2, 3)], columns=2)
    assert sheet.shape == (4, 6, 3)
    assert sheet[0, 0, 0] == 1
    assert sheet[0, 5, 0] == 2
    assert sheet[3, 0, 0] == 3
    assert sheet[3, 5, 0] == 255


def test_caption_stands_above_the_picture():
    picture = np.full((40, 200, 3), 90, dtype=np.uint8)
    written = caption(picture, "time 3")
    assert written.shape == (40 + STRIP, 200, 3)
    np.testing.assert_array_equal(written[STRIP:], picture)
    assert (written[:STRIP, :100] < 128).any()
    assert (written[:STRIP, 120:] == 255).all()


@pytest.mark.parametrize("width", [4, 30, 90])
def test_long_captions_are_cut_off_at_their_end(width):
    written = caption(np.zeros((2, width, 3), dtype=np.uint8), "quadruped_gallop.usdc, 16,000 faces")
    assert written.shape == (2 + STRIP, width, 3)
    assert width < 30 or (written[:STRIP, -4:] == 255).all()


def test_caption_has_a_bar_of_colours_where_there_is_room():
    colors = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    wide, narrow = (caption(np.zeros((2, width, 3), dtype=np.uint8), "d", (colors, "5 %")) for width in (300, 80))
    middle = wide[STRIP // 2].astype(int)
    red, blue = ((middle[:, c] - middle[:, 2 - c] > 200).nonzero()[0] for c in (0, 2))
    assert len(red) > 5
    assert red.max() < blue.min()
    assert np.ptp(narrow[:STRIP].astype(int), axis=2).max() < 20


def test_failed_picture_leaves_nothing_behind(tmp_path):
    with pytest.raises(OSError, match="none"):
        write_png(np.zeros((2, 2, 3), dtype=np.uint8), tmp_path / "none" / "a.png")
    assert not list(tmp_path.iterdir())


def sheet_of(folder: Path, **options: object) -> np.ndarray:
    render_sheet(folder / "in.usda", folder / "sheet.png", RenderOptions(size=(60, 40), device="cpu", **options))
    return np.array(Image.open(folder / "sheet.png"))


def test_sheet_has_a_picture_for_each_time(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    assert sheet_of(tmp_path, pictures=2).shape == (40 + STRIP, 120, 3)
    assert sheet_of(tmp_path, pictures=99).shape == (40 + STRIP, 180, 3)


def test_meshes_are_drawn_where_the_stage_puts_them(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    define_cloth(stage, "/Root/Far").AddTranslateOp().Set(Gf.Vec3d(30, 0, 0))
    stage.Save()
    picture = sheet_of(tmp_path, pictures=1, azimuth=0.0, elevation=80.0)
    columns = np.flatnonzero((picture[STRIP:] != picture[-1, 0]).any(axis=(0, 2)))
    # Two cloths with nothing between them.
    assert (np.diff(columns) > 20).sum() == 1


def test_reference_and_heatmap_are_rows_of_their_own(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    stage = cloth_stage(tmp_path / "reference.usda")
    UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).AddTranslateOp().Set(Gf.Vec3d(0, 0, 0.5))
    stage.Save()
    options = RenderOptions(pictures=2, size=(60, 40), heatmap=True, device="cpu")
    scale = render_sheet(tmp_path / "in.usda", tmp_path / "s.png", options, tmp_path / "reference.usda")
    assert scale > 0
    assert np.array(Image.open(tmp_path / "s.png")).shape == (3 * (40 + STRIP), 120, 3)


def drawn_box(picture: np.ndarray) -> tuple[float, float, float, float]:
    """First and last row and column, as shares of the picture, that are not background."""
    rows, columns = np.nonzero((picture != picture[-1, 0]).any(axis=2))
    height, width = picture.shape[:2]
    return rows.min() / height, (rows.max() + 1) / height, columns.min() / width, (columns.max() + 1) / width


def test_meshes_that_travel_are_in_the_middle_of_every_picture(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    move = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).AddTranslateOp()
    for time in (1.0, 2.0, 3.0):
        move.Set(Gf.Vec3d(40.0 * time, 0, 0), time)
    stage.Save()
    sheet = sheet_of(tmp_path, pictures=3)[STRIP:]
    for index in range(3):
        top, bottom, left, right = drawn_box(sheet[:, 60 * index : 60 * (index + 1)])
        assert top + bottom == pytest.approx(1.0, abs=0.1)
        assert left + right == pytest.approx(1.0, abs=0.1)
        assert max(bottom - top, right - left) > 0.7


def test_sheet_shows_display_colours_unless_plain_is_asked_for(tmp_path):
    stage = cloth_stage(tmp_path / "in.usda")
    UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Cloth")).CreateDisplayColorAttr([(1, 0, 0)])
    stage.Save()
    for plain in (False, True):
        drawn = sheet_of(tmp_path, pictures=1, plain=plain)[STRIP:].astype(int)
        assert (drawn[..., 0] - drawn[..., 2] > 100).any() != plain


@pytest.mark.parametrize(
    ("output", "options", "error"),
    [
        ("sheet.jpg", {}, OptionError),
        ("sheet.png", {"heatmap": True}, OptionError),
        ("none/sheet.png", {}, StageError),
    ],
)
def test_wrong_sheets_are_errors(tmp_path, output, options, error):
    cloth_stage(tmp_path / "in.usda")
    with pytest.raises(error):
        render_sheet(tmp_path / "in.usda", tmp_path / output, RenderOptions(size=(8, 8), device="cpu", **options))


def test_command_draws_a_sheet(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    arguments = ["render", str(tmp_path / "in.usda"), "-o", str(tmp_path / "s.png"), "--size", "40x30", "--lines"]
    result = CliRunner().invoke(app, [*arguments, "--device", "cpu"])
    assert result.exit_code == 0, result.output
    assert np.array(Image.open(tmp_path / "s.png")).shape == (30 + STRIP, 120, 3)


def test_size_that_is_none_is_named(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    result = CliRunner().invoke(app, ["render", str(tmp_path / "in.usda"), "-o", "s.png", "--size", "big"])
    assert result.exit_code != 0
    assert isinstance(result.exception, OptionError) or "size 'big'" in result.output


def test_films_repeat_and_keep_their_pictures(tmp_path):
    pictures = [np.full((6, 8, 3), level, dtype=np.uint8) for level in (0, 120, 250)]
    write_gif(pictures, tmp_path / "film.gif", frames_per_second=10)
    with Image.open(tmp_path / "film.gif") as film:
        assert (film.size, film.n_frames, film.info["loop"], film.info["duration"]) == ((8, 6), 3, 0, 100)
        for index, picture in enumerate(pictures):
            film.seek(index)
            assert np.abs(np.asarray(film.convert("RGB")).astype(int) - picture).max() <= 8


def test_film_that_cannot_be_written_leaves_nothing_behind(tmp_path):
    (tmp_path / "film.gif").mkdir()
    with pytest.raises(OSError, match="film"):
        write_gif([np.zeros((2, 2, 3), dtype=np.uint8)], tmp_path / "film.gif")
    assert [path.name for path in tmp_path.iterdir()] == ["film.gif"]
