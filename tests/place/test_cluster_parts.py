"""What belongs to clusters of levels, found on a device, is what the host finds."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from tests.support.moving_meshes import MESHES
from warpqem.options import read_keywords
from warpqem.pipeline.prepare import prepare
from warpqem.place.cluster_parts import ClusterParts, LevelParts


@pytest.mark.parametrize("name", ["bar", "cloth"])
def test_parts_found_on_a_device_are_those_of_the_host(name, device):
    points, faces = MESHES[name]
    work = prepare(points, faces, read_keywords({"target_faces": 100, "device": device}))
    ordered, faces = work.order(), work.mesh.faces
    root = ordered.root
    kept = np.unique(ordered.faces)[::3].astype(np.int32)
    index = np.full(len(root), -1, dtype=np.int32)
    index[kept] = np.arange(len(kept))
    cluster = index[root]

    def counts(of):
        valence = np.bincount(faces.ravel(), minlength=len(root))
        found = np.bincount(root, minlength=len(root)), np.bincount(root, valence, minlength=len(root))
        return tuple(values.astype(np.int32)[of] for values in found)

    wanted = ClusterParts.of(faces, ordered, cluster, len(kept), work.quadric_scale, device)
    there, corners = (wp.array(values, dtype=wp.int32, device=device) for values in (root, faces.ravel()))
    parts = LevelParts(faces, corners, ordered, work.quadric_scale, counts, device)
    found = parts.of(root, there, kept)
    for attribute in ("size", "highest_rank", "holder_count"):
        np.testing.assert_array_equal(getattr(found.clusters, attribute), getattr(wanted.clusters, attribute))
    for attribute in ("cluster", "holder"):
        ours, theirs = (getattr(one.clusters, attribute).numpy() for one in (found, wanted))
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(found.clusters.row.numpy(), ordered.row[root])
    count = int(wanted.own_faces.total.numpy()[0])
    assert found.own_faces.total.numpy()[0] == count <= found.room
    np.testing.assert_array_equal(found.own_faces.start.numpy(), wanted.own_faces.start.numpy())
    for ours, theirs in zip(found.own_faces.listed(found.room), wanted.own_faces.listed(count), strict=True):
        np.testing.assert_array_equal(ours.numpy()[:count], theirs.numpy()[:count])
    np.testing.assert_array_equal(found.half_edge, wanted.half_edge)
    np.testing.assert_array_equal(found.kind, wanted.kind)
    every = np.arange(len(root))
    np.testing.assert_array_equal(found.owner(every), wanted.owner(every))


def test_settings_of_vertices_loose_in_part_or_all_are_those_of_their_clusters(device):
    points, faces = MESHES["bar"]
    work = prepare(points, faces, read_keywords({"target_faces": 100, "device": device}))
    ordered = work.order()
    loose = np.zeros(len(ordered.root), dtype=bool)
    loose[ordered.root] = True
    placed = []
    for chosen in (loose, np.ones(len(loose), dtype=bool)):
        settings = replace(work.place_settings, loose=chosen)
        placer = replace(work, place_settings=settings).placer(ordered)
        placed.append(placer.clusters.rows["stiffness"])
    np.testing.assert_array_equal(*(np.asarray(values) for values in placed))
