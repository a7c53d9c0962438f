"""Comparing what meshes look like."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support import meshes
from warpqem.errors import DegenerateMeshError, MeshShapeError, NonFinitePointError, OptionError
from warpqem.picture import PosedMesh, View, compare_images
from warpqem.picture.images import IMAGE_VIEWS
from warpqem.picture.look import Look, Part, corner_normals, smoothing_groups

POINTS, FACES = meshes.icosphere(3)
COARSE_POINTS, COARSE_FACES = meshes.icosphere(1)
NOTHING = PosedMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))
SPHERE = PosedMesh(POINTS, FACES)


def compare(reference: PosedMesh, test: PosedMesh, **options: object):
    return compare_images([reference], [test], size=48, device="cpu", **options)


def colored(mesh: PosedMesh, color: tuple[float, float, float]) -> PosedMesh:
    count = len(mesh.faces)
    colors = np.broadcast_to(np.array(color), (count, 3, 3))
    look = Look(np.zeros(count, dtype=int), [Part("a")], colors=colors)
    return PosedMesh(mesh.points, mesh.faces, mesh.normals, look)


def test_equal_meshes_look_the_same():
    score = compare(SPHERE, SPHERE)
    assert score.gray.psnr is None
    assert score.gray.ssim == pytest.approx(1.0, abs=1e-12)
    assert score.silhouette == 1.0
    assert score.textured is None
    assert (score.frame_count, score.view_count, score.size) == (1, 4, 48)


def test_pictures_are_the_same_on_every_run():
    found = [compare(SPHERE, PosedMesh(COARSE_POINTS, COARSE_FACES)).to_dict() for _ in range(2)]
    assert found[0] == found[1]


def test_coarser_mesh_looks_less_alike():
    near, far = (compare(SPHERE, PosedMesh(*meshes.icosphere(level))) for level in (2, 1))
    assert near.gray.psnr > far.gray.psnr + 3
    assert near.gray.ssim > far.gray.ssim
    assert near.silhouette > far.silhouette


def test_normals_decide_the_shading_and_not_the_silhouette():
    # Those of a sphere on a coarser one.
    points, faces = meshes.icosphere(2)
    directions = points / np.linalg.norm(points, axis=1, keepdims=True)
    flat = np.zeros((len(faces), 3, 3))
    found = [compare(SPHERE, PosedMesh(points, faces, normals)) for normals in (directions[faces], flat)]
    assert found[0].gray.psnr > found[1].gray.psnr + 0.5
    assert found[0].gray.ssim > found[1].gray.ssim
    assert found[0].silhouette == found[1].silhouette
    assert found[0].shading.psnr > found[1].shading.psnr + 0.5


def test_shading_leaves_outlines_out():
    larger = PosedMesh(1.1 * POINTS, FACES)
    score = compare(SPHERE, larger)
    assert score.shading.psnr > score.gray.psnr + 6
    same = compare(SPHERE, SPHERE).shading
    assert same.psnr is None
    assert compare(SPHERE, NOTHING).shading is None


def test_colours_change_the_textured_pictures_alone():
    score = compare(colored(SPHERE, (0.8, 0.1, 0.1)), colored(SPHERE, (0.1, 0.1, 0.8)))
    assert score.gray.psnr is None
    assert score.textured.psnr < 15


def test_one_that_shows_nothing_has_no_overlap():
    score = compare(SPHERE, NOTHING)
    assert score.silhouette == 0.0
    assert score.gray.psnr < 20


def test_what_the_test_mesh_alone_has_counts():
    both = PosedMesh(
        np.concatenate([POINTS, POINTS * 0.2 + [0.0, 0.0, 1.0]]), np.concatenate([FACES, FACES + len(POINTS)])
    )
    assert compare(SPHERE, both).silhouette < 1.0
    assert compare_images([NOTHING, SPHERE], [SPHERE, SPHERE], size=24, device="cpu").silhouette == pytest.approx(0.5)


def test_reference_fills_the_pictures_of_all_frames():
    large, covered = PosedMesh(POINTS * 3 + [7.0, 0.0, 0.0], FACES), []
    compare_images([SPHERE, large], [SPHERE, large], size=48, device="cpu", drawn=covered.append)
    shares = [pair.reference.covered.mean() for pair in covered]
    assert shares[4:] == pytest.approx([np.pi / 4 / 1.06**2] * 4, abs=0.03)
    assert shares[:4] == pytest.approx([share / 9 for share in shares[4:]], abs=0.01)
    assert not any(pair.reference.covered[0].any() for pair in covered)


def test_two_empty_meshes_are_refused():
    with pytest.raises(DegenerateMeshError, match="no extent in any frame"):
        compare(NOTHING, NOTHING)


def test_a_frame_that_only_one_has_is_refused():
    with pytest.raises(MeshShapeError, match="frames: 1 of the reference and 2 of the test"):
        compare_images([SPHERE], [SPHERE, SPHERE], device="cpu")


def test_errors_name_the_side_and_the_frame():
    broken = POINTS.copy()
    broken[4, 1] = np.nan
    with pytest.raises(NonFinitePointError, match="test frame 1: point of vertex 4"):
        compare_images([SPHERE, SPHERE], [SPHERE, PosedMesh(broken, FACES)], device="cpu")
    with pytest.raises(MeshShapeError, match="reference frame 0: normals"):
        compare(PosedMesh(POINTS, FACES, np.zeros((2, 3, 3))), SPHERE)
    with pytest.raises(OptionError, match="size"):
        compare_images([SPHERE], [SPHERE], size=0, device="cpu")


def test_normal_that_points_away_at_an_outline_is_not_mirrored(device):
    # A quad at a grazing angle, shaded by normals that lean as far and just beyond the plane of the picture.
    axes = View(*IMAGE_VIEWS[0], (0.0, 0.0, 0.0), 1.0).axes()
    lean, across = np.array([-0.6, 0.8, 0.0]), np.array([0.8, 0.6, 0.0])
    forward = np.array([0.0, 0.0, 1.0])
    along = np.cross(lean + 0.3 * forward, across)
    points = np.array([across + along, across - along, -across - along, along - across]) @ axes
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    found = []
    for depth in (0.05, -0.05):
        normal = (lean + depth * forward) @ axes
        mesh = PosedMesh(points, faces, np.broadcast_to(normal / np.linalg.norm(normal), (2, 3, 3)))
        pictures = []
        compare_images([mesh], [mesh], size=16, device=device, drawn=pictures.append)
        assert pictures[0].reference.covered[8, 8] == 1.0
        found.append(pictures[0].reference.gray[8, 8].astype(int))
    assert np.abs(found[0] - found[1]).max() < 10


def test_surface_without_normals_is_smooth_as_far_as_its_edges_are():
    smooth = corner_normals(POINTS, FACES, smoothing_groups(POINTS, FACES))
    assert compare(SPHERE, PosedMesh(POINTS, FACES, smooth)).gray.psnr is None
