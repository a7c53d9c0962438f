"""Appearance measures: known errors of texture coordinates, normals and colours give known figures."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import warpqem
from tests.support import meshes
from warpqem.errors import MeshShapeError
from warpqem.measure import CornerValues, SurfaceValues, compare_appearance
from warpqem.measure.texture_coordinates import make_chart
from warpqem.pipeline.surface_transfer import surface_transfer

DIAGONAL = np.sqrt(2)  # of the unit square


def values(uv=None, normals=None, colors=None, **options):
    def corner(name, array):
        return {} if array is None else {name: CornerValues.of(name, array)}

    return SurfaceValues(
        uvs=corner("st", uv),
        normals=None if normals is None else CornerValues.of("normals", normals),
        colors=corner("displayColor", colors),
        **options,
    )


def still(points, frames=3):
    return np.repeat(np.asarray(points, dtype=np.float64)[None], frames, axis=0)


def flat_uv(points, faces):
    """Texture coordinates that are x and y."""
    return np.asarray(points, dtype=np.float64)[faces][..., :2]


def two_islands(points, faces):
    """The same, but faces right of the middle lie 10 further right in the texture: a seam at x = 0.5."""
    uv = flat_uv(points, faces)
    uv[points[faces][..., 0].mean(axis=1) > 0.5, :, 0] += 10
    return uv


def look(reference, test, device, **options):
    """Compare (points, faces, values) twice."""
    return compare_appearance(*reference, *test, **{"samples": 500, "device": device, **options})


def test_equal_meshes_look_equal(device):
    points, faces = meshes.swaying_sphere(3, 4)
    rng = np.random.default_rng(1)
    uv, normals, colors = rng.random((len(faces), 3, 2)), points[0][faces], rng.random((len(faces), 3, 3))
    mesh = (points, faces, values(uv, normals, colors))
    found = look(mesh, mesh, device)
    st = found.uvs["st"]
    assert st.error_largest < 1e-9
    assert st.swim < 1e-9
    assert st.stretch == st.stretch_reference
    assert st.seam_drift_largest < 1e-9
    assert found.normals.largest < 1e-9
    assert found.colors["displayColor"].largest < 1e-6
    assert found.not_measured == {}


def test_shift_of_texture_coordinates_is_their_error(device):
    points, faces = meshes.grid(8, 8)
    uv = flat_uv(points, faces)
    st = look(
        (still(points), faces, values(uv)), (still(points), faces, values(uv + np.array([0.03, 0.04]))), device
    ).uvs["st"]
    assert st.error == pytest.approx(0.05, rel=1e-9)
    assert st.error_p95 == pytest.approx(0.05, rel=1e-9)
    assert st.error_largest == pytest.approx(0.05, rel=1e-9)
    # It is off by the same amount all the time.
    assert st.swim < 1e-9


def test_linear_texture_coordinates_of_another_topology_have_no_error(device):
    points, faces = meshes.grid(12, 12)
    coarse, coarse_faces = meshes.grid(5, 5)
    fine = (still(points), faces, values(two_islands(points, faces)))
    # A seam in the middle needs a line of edges there.
    coarse[:, 0] = np.where(np.isclose(coarse[:, 0], 0.4), 0.5, coarse[:, 0])
    st = look(fine, (still(coarse), coarse_faces, values(two_islands(coarse, coarse_faces))), device).uvs["st"]
    assert st.error_largest < 1e-6
    assert st.seam_drift_largest < 1e-4


@pytest.mark.parametrize("scale", [1.0, 40.0])
def test_texture_that_swims_gives_the_way_it_swims(scale, device):
    points, faces = meshes.grid(8, 8)
    points = scale * points
    uv = flat_uv(points, faces)
    shift = np.array([0.0, 0.02, 0.01, -0.05])  # of a texture that spans the square once
    moving = uv[None] + scale * shift[:, None, None, None] * np.array([0.6, 0.8])
    st = look((still(points, 4), faces, values(uv)), (still(points, 4), faces, values(moving)), device).uvs["st"]
    assert st.swim == pytest.approx(100 * 0.05 / DIAGONAL, rel=1e-5)
    assert st.swim_p95 == pytest.approx(100 * 0.05 / DIAGONAL, rel=1e-5)


def test_vertices_that_slide_make_the_texture_swim(device):
    points, faces = meshes.grid(16, 16)
    uv = flat_uv(points, faces)
    test = still(points, 3)
    inside = (np.abs(points[:, :2] - 0.5) < 0.49).all(axis=1)
    test[2, inside, 0] += 0.02
    st = look((still(points, 3), faces, values(uv)), (test, faces, values(uv)), device, samples=4000).uvs["st"]
    # All but the outermost ring of faces.
    assert st.swim_p95 == pytest.approx(100 * 0.02 / DIAGONAL, rel=1e-6)
    assert st.swim == pytest.approx(100 * 0.02 / DIAGONAL, rel=0.1)


def test_rigid_motion_makes_no_texture_swim(device):
    points, faces = meshes.icosphere(3)
    coarse, coarse_faces = meshes.icosphere(2)
    fine, coarse = (meshes.rigid_motion(p, 5) for p in (points, coarse))
    rng = np.random.default_rng(0)
    way = rng.normal(size=(3, 2))
    uv, coarse_uv = (p[0].astype(np.float64)[f] @ way for p, f in ((fine, faces), (coarse, coarse_faces)))
    st = look((fine, faces, values(uv)), (coarse, coarse_faces, values(coarse_uv)), device).uvs["st"]
    assert st.error > 1e-4
    assert st.swim < 1e-3


def test_seam_that_moved_by_some_way_drifts_by_it(device):
    points, faces = meshes.grid(10, 4)
    uv = two_islands(points, faces)
    moved = still(points)
    moved[:, np.isclose(points[:, 0], 0.5), 0] += 0.03
    diagonal = np.linalg.norm(np.ptp(points, axis=0))
    st = look((still(points), faces, values(uv)), (moved, faces, values(uv)), device).uvs["st"]
    assert st.seam_drift == pytest.approx(100 * 0.03 / diagonal, rel=1e-5)
    assert st.seam_drift_largest == pytest.approx(100 * 0.03 / diagonal, rel=1e-5)
    # No coordinate is compared with one of the other island, which is 10 away.
    assert st.error_largest < 0.1


def test_stretch_is_that_of_the_textbook_case(device):
    points, faces = meshes.grid(6, 6)
    uv = flat_uv(points, faces)
    squeezed = uv * [0.5, 1.0]
    st = look((still(points), faces, values(uv)), (still(points), faces, values(squeezed)), device).uvs["st"]
    assert st.stretch_reference == pytest.approx(1.0, rel=1e-6)
    # Singular values 2 and 1, scaled by the root of the area ratio, 1/2.
    assert st.stretch == pytest.approx(np.sqrt((4 + 1) / 2 * 0.5), rel=1e-6)


def test_stretch_follows_the_motion(device):
    points, faces = meshes.grid(6, 6)
    moving = np.stack([points, points * [2, 1, 1]])
    mesh = (moving, faces, values(flat_uv(points, faces)))
    assert look(mesh, mesh, device).uvs["st"].stretch == pytest.approx((1 + np.sqrt((4 + 1) / 2 / 2)) / 2, rel=1e-6)


@pytest.mark.parametrize("angle", [0.001, 10.0, 90.0, 179.0])
def test_turned_normal_gives_its_angle(angle, device):
    points, faces = meshes.grid(4, 4)
    up = np.broadcast_to([0.0, 0, 2.0], (len(faces), 3, 3))
    turn = np.radians(angle)
    turned = np.broadcast_to([np.sin(turn), 0, np.cos(turn)], (len(faces), 3, 3))
    found = look((still(points), faces, values(normals=up)), (still(points), faces, values(normals=turned)), device)
    assert found.normals.mean == pytest.approx(angle, rel=1e-9)
    assert found.normals.largest == pytest.approx(angle, rel=1e-9)


def test_colors_are_compared_where_they_are_seen(device):
    points, faces = meshes.grid(10, 10)
    coarse, coarse_faces = meshes.grid(2, 2)
    left_red = np.where(points[faces].mean(axis=1)[:, :1] < 0.5, [[1.0, 0, 0]], [[0.0, 0, 1.0]])
    red = np.broadcast_to([1.0, 0, 0], (len(coarse_faces), 3, 3))
    fine = values(colors=np.repeat(left_red[:, None], 3, axis=1))
    found = look((still(points), faces, fine), (still(coarse), coarse_faces, values(colors=red)), device, samples=4000)
    errors = found.colors["displayColor"]
    # Red and blue of sRGB differ by 52.87; half of the square is blue.
    assert errors.largest == pytest.approx(52.87, abs=0.02)
    assert errors.mean == pytest.approx(52.87 / 2, rel=0.05)


def test_opposite_sides_of_a_plate_are_not_taken_for_each_other(device):
    points, faces = meshes.grid(8, 8)
    plate = np.concatenate([points, points + np.array([0, 0, 0.004], dtype=np.float32)])
    both = np.concatenate([faces[:, ::-1], faces + len(points)])
    colors = np.repeat(np.arange(2.0), len(faces))[:, None, None] * np.ones((1, 3, 3))
    thick = plate.copy()
    thick[: len(points), 2] += 0.003
    mesh = values(colors=colors)
    found = look((still(plate), both, mesh), (still(thick), both, mesh), device)
    assert found.colors["displayColor"].largest < 1e-9


def test_what_is_missing_has_its_reason_and_no_number(device):
    points, faces = meshes.grid(4, 4)
    uv = flat_uv(points, faces)
    bare = values(unusable={"st": "5 values for 96 corners"})
    found = look((still(points), faces, values(uv)), (still(points), faces, bare), device)
    assert found.uvs == {}
    assert found.normals is None
    assert found.not_measured == {
        "st": "test mesh: 5 values for 96 corners",
        "normals": "neither mesh has normals",
        "colors": "neither mesh has colours",
    }


def test_parts_of_the_figures_without_a_value_have_their_reasons(device):
    points, faces = meshes.grid(4, 4)
    mesh = (points, faces, values(np.zeros((len(faces), 3, 2))))
    found = look(mesh, mesh, device)
    st = found.uvs["st"]
    assert (st.swim, st.stretch, st.seam_drift) == (None, None, None)
    assert found.not_measured["st: swim"] == "one frame only"
    assert found.not_measured["st: seam drift"] == "neither mesh has a seam of st"
    assert found.not_measured["st: stretch"] == "st covers no area on the test mesh"
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False)) == found.to_dict()


def test_values_of_another_shape_are_refused(device):
    points, faces = meshes.grid(4, 4)
    mesh = (points, faces, values(np.zeros((len(faces) - 1, 3, 2))))
    with pytest.raises(MeshShapeError, match=r"st: expected corner values of shape \(32, 3, 2\), got \(31, 3, 2\)"):
        look(mesh, mesh, device)
    with pytest.raises(MeshShapeError, match="normals"):
        CornerValues.of("normals", np.zeros((4, 3)))


def test_long_clips_are_measured_in_frames_up_to_the_last(device):
    points, faces = meshes.grid(2, 2)
    shift = np.zeros((700, 1, 1, 2))
    shift[-1, ..., 0] = 0.1
    uv = flat_uv(points, faces)
    mesh = still(points, 700)
    found = compare_appearance(mesh, faces, values(uv), mesh, faces, values(uv + shift), samples=20, device=device)
    assert found.frame_count == 500
    assert found.uvs["st"].swim == pytest.approx(100 * 0.1 / DIAGONAL, rel=1e-5)


def test_islands_and_seams_of_a_cut_square():
    points, faces = meshes.grid(4, 4)
    chart = make_chart(faces, two_islands(points, faces))
    assert len(np.unique(chart.island)) == 2
    ends = points[faces.ravel()[chart.seam]]
    np.testing.assert_array_equal(ends[..., 0], 0.5)
    assert len(chart.seam) == 4


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_no_figure_depends_on_the_order_or_winding_of_faces(seed):
    rng = np.random.default_rng(seed)
    points, faces = meshes.torus(12, 8)
    moving = np.stack([points, points + rng.normal(0, 0.005, points.shape)])
    normals, colors = points[faces], rng.random((len(faces), 3, 3))
    uv = points[faces] @ rng.normal(size=(3, 2))
    reference = (moving, faces, values(uv, normals, colors))
    order = rng.permutation(len(faces))
    mixed = tuple(array[order][:, ::-1] for array in (uv, normals, colors))
    found = compare_appearance(*reference, moving, faces[order][:, ::-1], values(*mixed), samples=200, device="cpu")
    assert found.uvs["st"].error_largest < 1e-7
    assert found.normals.largest < 1e-5
    assert found.colors["displayColor"].largest < 1e-3


def test_a_simplified_mesh_that_slides_more_swims_more(device):
    points, faces = meshes.waving_grid(24, 6)
    uv = flat_uv(points[0], faces)
    swims = []
    for coherence in (0.0, 1.0):
        result = warpqem.simplify(points, faces, ratio=0.2, coherence=coherence, device=device)
        transfer = surface_transfer(points[0], faces, result, device=device)
        coarse_uv = transfer.wedges_from_corners(uv)[transfer.corner_wedge]
        test = (result.points, result.faces, values(coarse_uv))
        swims.append(look((points, faces, values(uv)), test, device).uvs["st"].swim)
    assert swims[1] < 0.7 * swims[0]
