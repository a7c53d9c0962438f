"""The animated scenes: what the generators promise, and that the committed files hold just that."""

import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom, UsdSkel

from scenes import cape, head, head_shape, quadruped
from scenes.remesh import vertex_normals
from scenes.scene import Scene
from scenes.stage import FIRST_TIME_CODE, write
from tests.support.meshes import shape_quality

FOLDER = Path(__file__).parents[2] / "scenes"
BUILDERS = {"quadruped_gallop": quadruped.build, "cape_wind": cape.build, "talking_head": head.build}
NAMES = tuple(BUILDERS)
SKINNED = ("quadruped_gallop", "talking_head")


@cache
def generated(name: str) -> Scene:
    return BUILDERS[name]()


@cache
def committed(name: str) -> Usd.Stage:
    # Kept: a prim outlives its stage as an invalid one only.
    return Usd.Stage.Open(str(FOLDER / f"{name}.usdc"))


def mesh_of(stage: Usd.Stage) -> UsdGeom.Mesh:
    return UsdGeom.Mesh(stage.GetDefaultPrim().GetChild("Mesh"))


def edge_uses(faces: NDArray) -> tuple[NDArray, NDArray]:
    """Return the edges and the number of faces at each."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0, return_counts=True)


def euler_number(scene: Scene) -> int:
    return len(scene.points) - len(edge_uses(scene.faces)[0]) + len(scene.faces)


def border_loop_count(faces: NDArray) -> int:
    edges, uses = edge_uses(faces)
    follow: dict[int, set[int]] = {}
    for a, b in edges[uses == 1].tolist():
        follow.setdefault(a, set()).add(b)
        follow.setdefault(b, set()).add(a)
    assert all(len(nexts) == 2 for nexts in follow.values())
    loops, seen = 0, set()
    for start in follow:
        if start not in seen:
            loops += 1
            stack = [start]
            while stack:
                at = stack.pop()
                if at not in seen:
                    seen.add(at)
                    stack += follow[at]
    return loops


def blended(scene: Scene, name: str) -> NDArray:
    """Return the rest points with one blend shape fully on."""
    shape = next(shape for shape in scene.blend.shapes if shape.name == name)
    points = scene.points.copy()
    points[shape.vertices] += shape.offsets
    return points


# Topology


@pytest.mark.parametrize("name", NAMES)
def test_mesh_is_an_oriented_manifold_of_one_piece(name: str) -> None:
    faces = generated(name).faces
    assert edge_uses(faces)[1].max() == 2
    half_edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(half_edges, axis=0)) == len(half_edges)
    label = np.arange(len(generated(name).points))
    while True:
        least = label.copy()
        np.minimum.at(least, faces.ravel(), np.repeat(label[faces].min(axis=1), 3))
        if (least == label).all():
            break
        label = least
    assert (label == 0).all()


@pytest.mark.parametrize(
    ("name", "euler", "loops"), [("quadruped_gallop", 2, 0), ("cape_wind", 1, 1), ("talking_head", 1, 1)]
)
def test_mesh_has_the_topology_of_a_sphere_or_a_disc(name: str, euler: int, loops: int) -> None:
    assert euler_number(generated(name)) == euler
    assert border_loop_count(generated(name).faces) == loops


@pytest.mark.parametrize(
    ("name", "face_count"), [("quadruped_gallop", 16000), ("cape_wind", 5000), ("talking_head", 11000)]
)
def test_face_count_is_the_one_asked_for_to_a_percent(name: str, face_count: int) -> None:
    assert len(generated(name).faces) == pytest.approx(face_count, rel=0.01)


@pytest.mark.parametrize("name", ["quadruped_gallop", "talking_head"])
def test_triangles_of_the_remeshed_scenes_are_well_shaped(name: str) -> None:
    quality = shape_quality(generated(name).points, generated(name).faces)
    assert quality.min() > 0.1
    assert np.median(quality) > 0.95


def test_quadruped_faces_look_outwards() -> None:
    corner = generated("quadruped_gallop").points[generated("quadruped_gallop").faces].astype(float)
    volume = np.einsum("ni,ni->n", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])).sum() / 6.0
    # A horse of this height weighs about 500 kg.
    assert 0.25 < volume < 0.75


def test_head_faces_look_outwards() -> None:
    scene = generated("talking_head")
    normals = vertex_normals(scene.points.astype(float), scene.faces)
    assert normals[scene.points[:, 2].argmax(), 2] > 0.8
    assert normals[scene.points[:, 1].argmax(), 1] > 0.8


# Skin


@pytest.mark.parametrize("name", SKINNED)
def test_skin_weights_sum_to_one(name: str) -> None:
    weights = generated(name).binding.joint_weights
    assert weights.shape == (len(generated(name).points), 4)
    assert weights.min() >= 0.0
    assert np.abs(weights.sum(axis=1) - 1.0).max() < 1e-6


def test_no_leg_drags_the_leg_of_the_other_side() -> None:
    scene = generated("quadruped_gallop")
    binding = scene.binding
    names = np.array(binding.skeleton.names)
    side = np.where(np.char.endswith(names, "_left"), 1, np.where(np.char.endswith(names, "_right"), -1, 0))
    # Below the knees only the bones of the leg itself may act.
    low = np.flatnonzero((scene.points[:, 1] < 0.5) & (np.abs(scene.points[:, 0]) > 0.06))
    acting = binding.joint_weights[low] > 0.0
    own = side[binding.joint_indices[low]] == np.sign(scene.points[low, 0])[:, None]
    assert (own | ~acting).all()
    fore = np.char.startswith(names[binding.joint_indices[low]], "fore")
    assert (fore == (scene.points[low, 2] > 0.0)[:, None])[acting].all()


def test_neighbouring_vertices_have_similar_weights() -> None:
    scene = generated("quadruped_gallop")
    dense = np.zeros((len(scene.points), len(scene.binding.skeleton.names)))
    np.put_along_axis(dense, scene.binding.joint_indices, scene.binding.joint_weights, axis=1)
    edges = edge_uses(scene.faces)[0]
    assert np.abs(dense[edges[:, 0]] - dense[edges[:, 1]]).max() < 0.6


@pytest.mark.parametrize("name", SKINNED)
def test_rest_pose_leaves_the_points_where_they_are(name: str) -> None:
    binding = generated(name).binding
    identity = binding.skeleton.world(binding.skeleton.rest) @ np.linalg.inv(binding.skeleton.bind())
    np.testing.assert_allclose(identity, np.eye(4) + np.zeros_like(identity), atol=1e-12)


@pytest.mark.parametrize("name", SKINNED)
def test_usd_skinning_of_the_committed_file_gives_the_baked_points(name: str, tmp_path: Path) -> None:
    # Baking edits the layer, so it works on a copy.
    stage = Usd.Stage.Open(shutil.copy(FOLDER / f"{name}.usdc", tmp_path))
    root = UsdSkel.Root(stage.GetDefaultPrim())
    baked = generated(name).baked()
    assert UsdSkel.BakeSkinning(root, Gf.Interval(FIRST_TIME_CODE, FIRST_TIME_CODE + len(baked) - 1))
    points = mesh_of(stage).GetPointsAttr()
    for frame in range(0, len(baked), 5):
        usd = np.array(points.Get(FIRST_TIME_CODE + frame))
        assert np.abs(usd - baked[frame]).max() < 1e-4


# Motion


@pytest.mark.parametrize("name", ["quadruped_gallop", "cape_wind"])
def test_loop_closes_without_a_jump(name: str) -> None:
    baked = generated(name).baked()
    steps = np.linalg.norm(np.roll(baked, -1, axis=0) - baked, axis=2).max(axis=1)
    assert steps[-1] <= 1.1 * steps[:-1].max()


def test_gallop_has_a_moment_with_all_hooves_in_the_air_and_none_far_below_the_ground() -> None:
    lowest = generated("quadruped_gallop").baked()[:, :, 1].min(axis=1)
    assert lowest.max() > 0.05
    assert lowest.min() > -0.1


def test_cape_is_pinned_at_the_collar_and_moves_most_at_the_hem() -> None:
    baked = generated("cape_wind").baked()
    collar = np.flatnonzero((baked == baked[:1]).all(axis=(0, 2)))
    travel = np.ptp(baked, axis=0).max(axis=1)
    height = generated("cape_wind").points[:, 1]
    assert len(collar) >= 20
    assert height[collar].min() > 1.4
    thirds = np.quantile(height, [1 / 3, 2 / 3])
    means = [part.mean() for part in (travel[height > thirds[1]], travel[height < thirds[0]])]
    assert means[1] > 3.0 * means[0]


def test_cape_is_not_torn_or_stretched_by_the_wind() -> None:
    scene = generated("cape_wind")
    edges = edge_uses(scene.faces)[0]
    lengths = np.linalg.norm(scene.baked()[:, edges[:, 0]] - scene.baked()[:, edges[:, 1]], axis=2)
    rest = np.linalg.norm(scene.points[edges[:, 0]] - scene.points[edges[:, 1]], axis=1)
    assert (lengths / rest).max() < 2.0
    assert (lengths / rest).min() > 0.25


def test_cape_texture_has_two_islands_with_a_seam_between() -> None:
    scene = generated("cape_wind")
    coordinates = scene.texture_coordinates
    assert coordinates.values.min() >= 0.0
    assert coordinates.values.max() <= 1.0
    pairs = np.unique(np.stack([scene.faces.ravel(), coordinates.indices.ravel()], axis=1), axis=0)
    per_vertex = np.bincount(pairs[:, 0], minlength=len(scene.points))
    assert set(per_vertex.tolist()) == {1, 2}
    seam = scene.points[per_vertex == 2]
    np.testing.assert_allclose(seam[:, 0], 0.0, atol=1e-6)
    edges = edge_uses(coordinates.indices)[0]
    adjacent = {a: set() for a in range(len(coordinates.values))}
    for a, b in edges.tolist():
        adjacent[a].add(b)
        adjacent[b].add(a)
    seen, stack = set(), [0]
    while stack:
        at = stack.pop()
        if at not in seen:
            seen.add(at)
            stack += adjacent[at]
    assert 0.4 < len(seen) / len(coordinates.values) < 0.6


def test_cape_texture_is_not_mirrored() -> None:
    coordinates = generated("cape_wind").texture_coordinates
    a, b, c = np.moveaxis(coordinates.values[coordinates.indices].astype(float), 1, 0)
    areas = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert (np.sign(areas) == np.sign(areas[0])).all()


# Face


def lip_pairs(scene: Scene) -> NDArray:
    """Return the pairs of vertices ``(M, 2)`` that lie in one place at rest."""
    order = np.lexsort(scene.points.T)
    same = (scene.points[order[:-1]] == scene.points[order[1:]]).all(axis=1)
    return np.stack([order[:-1][same], order[1:][same]], axis=1)


def test_lips_touch_at_rest_along_the_contact_line() -> None:
    scene = generated("talking_head")
    pairs = lip_pairs(scene)
    at = scene.points[pairs[:, 0]]
    assert len(pairs) >= 12
    np.testing.assert_allclose(at[:, 1], head_shape.contact_line(at[:, 0]), atol=0.02)
    assert np.ptp(at[:, 0]) > 0.8 * 2.0 * head_shape.MOUTH_HALF_WIDTH


def test_lips_part_when_the_jaw_opens_and_stay_closed_in_the_other_shapes() -> None:
    scene = generated("talking_head")
    pairs = lip_pairs(scene)
    for shape in scene.blend.shapes:
        moved = blended(scene, shape.name)
        gap = np.linalg.norm(moved[pairs[:, 0]] - moved[pairs[:, 1]], axis=1)
        if shape.name == "jawOpen":
            assert gap.max() > 1.5
        else:
            assert gap.max() < 1e-5


def test_blink_moves_one_eye_only() -> None:
    scene = generated("talking_head")
    for name, sign in (("blinkLeft", 1.0), ("blinkRight", -1.0)):
        moving = next(shape for shape in scene.blend.shapes if shape.name == name).vertices
        assert (sign * scene.points[moving, 0] > 1.0).all()


def test_blink_covers_the_pupil() -> None:
    scene = generated("talking_head")
    offset = scene.points - head_shape.EYE
    pupil = np.argmin(offset[:, 0] ** 2 + offset[:, 1] ** 2 + 100.0 * (offset[:, 2] < 0.0))
    closed = blended(scene, "blinkLeft") - head_shape.EYE
    assert closed[pupil, 1] < offset[pupil, 1] - 0.15


def test_blend_shapes_are_sparse_and_all_are_used() -> None:
    scene = generated("talking_head")
    for shape, weights in zip(scene.blend.shapes, scene.blend.weights.T, strict=True):
        assert 0 < len(shape.vertices) < 0.5 * len(scene.points)
        assert (np.diff(shape.vertices) > 0).all()
        assert weights.max() > 0.4
        assert weights.min() == 0.0
        assert weights.max() <= 1.0


# Files


@pytest.mark.parametrize("name", NAMES)
def test_committed_file_holds_what_the_generator_makes(name: str) -> None:
    scene, mesh = generated(name), mesh_of(committed(name))
    np.testing.assert_array_equal(np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3), scene.faces)
    assert np.abs(np.array(mesh.GetPointsAttr().Get()) - scene.points).max() < 1e-5
    if scene.point_samples is not None:
        for frame, sample in enumerate(scene.point_samples):
            assert np.abs(np.array(mesh.GetPointsAttr().Get(FIRST_TIME_CODE + frame)) - sample).max() < 1e-5


def test_generator_repeats_itself_and_follows_its_seed() -> None:
    first, again, other = cape.build(800, 4), cape.build(800, 4), cape.build(800, 4, seed=12)
    np.testing.assert_array_equal(first.baked(), again.baked())
    np.testing.assert_array_equal(first.faces, again.faces)
    assert np.abs(first.baked() - other.baked()).max() > 0.01


@pytest.mark.parametrize("name", NAMES)
def test_stage_metadata_is_set(name: str) -> None:
    stage, scene = committed(name), generated(name)
    assert stage.GetDefaultPrim().GetName() == scene.name
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y
    assert UsdGeom.GetStageMetersPerUnit(stage) == scene.meters_per_unit
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1.0, scene.frame_count)
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == 24.0


@pytest.mark.parametrize("name", NAMES)
def test_mesh_has_extent_and_colors_and_no_subdivision(name: str) -> None:
    mesh = mesh_of(committed(name))
    points = np.array(mesh.GetPointsAttr().Get())
    np.testing.assert_array_equal(np.array(mesh.GetExtentAttr().Get()), [points.min(axis=0), points.max(axis=0)])
    assert mesh.GetSubdivisionSchemeAttr().Get() == UsdGeom.Tokens.none
    assert mesh.GetDisplayColorPrimvar().GetInterpolation() == UsdGeom.Tokens.vertex
    assert len(mesh.GetDisplayColorPrimvar().Get()) == len(points)


def test_cape_extent_follows_its_points() -> None:
    mesh = mesh_of(committed("cape_wind"))
    assert mesh.GetPointsAttr().GetTimeSamples() == mesh.GetExtentAttr().GetTimeSamples() == list(range(1, 25))
    points = np.array(mesh.GetPointsAttr().Get(9))
    np.testing.assert_array_equal(np.array(mesh.GetExtentAttr().Get(9)), [points.min(axis=0), points.max(axis=0)])


@pytest.mark.parametrize("name", SKINNED)
def test_skin_is_bound_by_the_skel_schemas(name: str) -> None:
    stage = committed(name)
    root = stage.GetDefaultPrim()
    assert root.IsA(UsdSkel.Root)
    prim = mesh_of(stage).GetPrim()
    assert prim.HasAPI(UsdSkel.BindingAPI)
    cache_of_skins = UsdSkel.Cache()
    cache_of_skins.Populate(UsdSkel.Root(root), Usd.PrimDefaultPredicate)
    skinning = cache_of_skins.GetSkinningQuery(prim)
    skeleton = cache_of_skins.GetSkelQuery(UsdSkel.Skeleton(root.GetChild("Skeleton")))
    assert skinning.HasJointInfluences()
    assert skinning.GetNumInfluencesPerComponent() == 4
    assert skinning.HasBlendShapes() == (name == "talking_head")
    assert skeleton.HasBindPose()
    assert skeleton.HasRestPose()
    assert len(skeleton.GetAnimQuery().GetJointTransformTimeSamples()) == 48


@pytest.mark.parametrize("name", NAMES)
def test_files_are_small(name: str) -> None:
    assert (FOLDER / f"{name}.usdc").stat().st_size < 1.5e6
    assert sum((FOLDER / f"{other}.usdc").stat().st_size for other in NAMES) < 3.0e6


def test_written_stage_reads_back(tmp_path: Path) -> None:
    scene = cape.build(200, 3)
    write(scene, tmp_path / "cape.usda")
    stage = Usd.Stage.Open(str(tmp_path / "cape.usda"))
    mesh = mesh_of(stage)
    st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    assert st.GetInterpolation() == UsdGeom.Tokens.faceVarying
    np.testing.assert_array_equal(np.array(st.GetIndices()).reshape(-1, 3), scene.texture_coordinates.indices)
    np.testing.assert_allclose(np.array(mesh.GetPointsAttr().Get(3)), scene.point_samples[2], atol=1e-6)
