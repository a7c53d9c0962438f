"""Quadrics of other vertices that count at a vertex: equation 1 of the face paper."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

import warpqem
from tests.oracles import quadrics as oracle
from tests.oracles.face import equation_one
from tests.support import meshes
from tests.support.mesh_state import build_mesh
from warpqem.decimation.quadric_sums import QuadricSums, add_quadric_sums
from warpqem.face import FaceProtection, FacialFeatures, face_sums
from warpqem.frames.device_frames import to_device
from warpqem.options import MeshOptions
from warpqem.pipeline.prepare import prepare
from warpqem.place.cluster_rows import match_keys

MESHES = {"closed": meshes.swaying_sphere(1, 3), "open": meshes.bending_bar(6, 4, 3)}


def features(*vertices: int) -> FacialFeatures:
    """Feature points of these vertices, under any names."""
    names = ("chin", "nose_tip", "throat")[: len(vertices)]
    return FacialFeatures(dict(zip(names, vertices, strict=True)), dict.fromkeys(names, 1.0), {}, np.eye(3))


@pytest.mark.parametrize("ring", [0, 1, 2])
@pytest.mark.parametrize("name", MESHES)
def test_feature_points_have_the_quadric_of_equation_one(name, ring, device):
    points, faces = MESHES[name]
    mesh = build_mesh(points, faces, device)
    before = mesh.quadric
    # Two of them are neighbours: each sums the other as it was.
    chosen = (int(faces[0, 0]), int(faces[0, 1]), int(faces[-1, 0]))
    sums = face_sums(faces, FaceProtection(features(*chosen), weight=100.0, ring=ring))
    add_quadric_sums(sums, mesh.frames.position, mesh.frames.quadric)
    for vertex in chosen:
        expected = [oracle.pack(equation_one(x, faces, vertex, 100.0, ring)) for x in points]
        scale = np.abs(expected).max()
        np.testing.assert_allclose(mesh.quadric[vertex], expected, rtol=1e-4, atol=1e-5 * scale)
    others = np.setdiff1d(np.arange(points.shape[1]), chosen)
    np.testing.assert_array_equal(mesh.quadric[others], before[others])


def test_a_feature_point_is_off_the_planes_of_its_neighbours(device):
    points, faces = MESHES["closed"]
    mesh = build_mesh(points, faces, device)
    assert mesh.quadric[0, :, 9].max() == 0.0
    added = add_quadric_sums(face_sums(faces, FaceProtection(features(0))), mesh.frames.position, mesh.frames.quadric)
    assert added.shape[0] == 1
    assert mesh.quadric[0, :, 9].min() > 0.0


@given(st.permutations(range(8)), st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7)), min_size=1, unique=True))
def test_renumbered_rows_name_the_same_vertices(place, pairs):
    row, vertex = np.array(pairs).T
    weight = 1.0 + np.arange(len(pairs), dtype=np.float32)
    place = np.array(place)
    moved = QuadricSums.of_entries(row, vertex, weight).renumbered(place)
    found = dict(zip(zip(moved.entry_row.tolist(), moved.vertex.tolist(), strict=True), moved.weight, strict=True))
    expected = zip(zip(place[row].tolist(), place[vertex].tolist(), strict=True), weight, strict=True)
    assert found == dict(expected)


@given(st.lists(st.integers(0, 5), max_size=9), st.lists(st.integers(0, 5), max_size=9))
def test_keys_are_matched_with_all_their_items(wanted, key):
    entry, item = match_keys(np.array(wanted, dtype=int), np.array(key, dtype=int))
    expected = [(i, j) for i, value in enumerate(wanted) for j, other in enumerate(key) if other == value]
    assert list(zip(entry.tolist(), item.tolist(), strict=True)) == expected


@pytest.mark.parametrize("name", MESHES)
def test_vertices_are_placed_by_the_same_sums(name, device):
    points, faces = MESHES[name]
    rng, count = np.random.default_rng(1), points.shape[1]
    row, vertex = np.divmod(rng.choice(count * count, 4 * count, replace=False), count)
    weight = rng.uniform(0.1, 2.0, len(row))
    work = prepare(points, faces, MeshOptions(ratio=0.3, device=device))
    assert work.order_input is not None
    sums = QuadricSums.of_entries(row, vertex, weight)
    work = replace(work, quadric_sums=sums, order_input=replace(work.order_input, sums=sums))
    placer = work.placer(work.order())
    frames = work.mesh.points(slice(0, len(points)))
    placed = placer.place(work.mesh, to_device(frames, device)).fetch().points
    given = placer.clusters.rows
    rows = {name: values.numpy() if isinstance(values, wp.array) else values for name, values in given.items()}
    unit = work.mesh.to_unit(frames).astype(np.float64)
    solved = np.flatnonzero(rows["solved"])
    assert len(solved) > 3
    for frame, x in enumerate(unit):
        own = oracle.vertex_quadrics(x, faces)
        for c in solved:
            entries = slice(rows["member_start"][c], rows["member_start"][c + 1])
            anchor = rows["member_weight"][entries].astype(float) @ x[rows["member"][entries]]
            total = oracle.zero()
            for v in np.flatnonzero(placer.vertex_map == c):
                total += oracle.shifted(own[v], anchor - x[v])
                for other, factor in zip(vertex[row == v], weight[row == v], strict=True):
                    total += oracle.shifted(own[other], anchor - x[other]).scaled(factor)
            expected = anchor + oracle.tangential_minimiser(total, float(rows["stiffness"][c]))
            np.testing.assert_allclose(placed[frame, c], expected, atol=1e-4)


def test_normals_are_those_of_the_faces_of_a_cluster_alone(device):
    points, faces = MESHES["closed"]
    face = FaceProtection(features(0), keep=False)
    plain, summed = (
        prepare(points, faces, MeshOptions(ratio=0.9, device=device, **options))
        for options in ({}, {"metric": "face", "face": face})
    )
    normals = []
    for work in (plain, summed):
        placer = work.placer(work.order())
        vertex = int(placer.vertex_map[0])
        if np.count_nonzero(placer.vertex_map == vertex) == 1:
            frame = to_device(work.mesh.points(slice(0, 1)), device)
            normals.append(placer.place(work.mesh, frame).fetch().normals[0, vertex])
    assert len(normals) == 2
    np.testing.assert_allclose(*normals, rtol=1e-4, atol=1e-6)


def test_a_progressive_mesh_has_the_same_levels(device):
    points, faces = MESHES["open"]
    options = {"metric": "face", "face": FaceProtection(features(7, 20)), "quality": "fast", "device": device}
    mesh = warpqem.build_progressive(points, faces, **options)
    level = mesh.level(mesh.splits_for(ratio=0.3))
    result = warpqem.simplify(points, faces, ratio=0.3, **options)
    np.testing.assert_array_equal(level.faces, result.faces)
    np.testing.assert_array_equal(level.points, result.points)


def test_an_order_along_a_curve_keeps_the_same_points(device, monkeypatch):
    points, faces = meshes.swaying_sphere(3, 3)
    options = {"metric": "face", "face": FaceProtection(features(5, 100), keep=False), "device": device}
    for threshold in (10**9, 0):
        monkeypatch.setattr("warpqem.decimation.decimate.ARRANGED_FACES", threshold)
        result = warpqem.simplify(points, faces, ratio=0.1, **options)
        for vertex in (5, 100):
            np.testing.assert_array_equal(result.points[:, result.vertex_map[vertex]], points[:, vertex])


def test_memoryless_quadrics_keep_the_sums(device):
    points, faces = meshes.swaying_sphere(3, 3)
    options = {"memoryless": True, "ratio": 0.1, "device": device}
    plain = warpqem.simplify(points, faces, **options)
    face = FaceProtection(features(5, 100), keep=False)
    result = warpqem.simplify(points, faces, metric="face", face=face, **options)
    for vertex in (5, 100):
        np.testing.assert_array_equal(result.points[:, result.vertex_map[vertex]], points[:, vertex])
        assert np.linalg.norm(plain.points - points[:, None, vertex], axis=2).min() > 0.0
