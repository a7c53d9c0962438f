"""Simplify the rest pose of a skinned mesh by the quadrics of all poses, pulled back to it.

"Pose-independent simplification of articulated meshes" (DeCoro & Rusinkiewicz 2005), one of the two methods that the
fit of :mod:`warpqem.skinning.fit_skin` is measured against: in pose ``j`` the joints take a vertex by the blended
transform ``L``; its quadric there, ``A``, measures displacements ``d`` of the rest position as ``d^T L^T A L d``. These
matrices are summed over the poses, edges collapse in the rest pose by that sum, and one solve places each vertex. Skin
weights are interpolated. (The other one is ``dsd`` over the poses with interpolated weights, Mohr & Gleicher 2003.)
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warpqem.arguments.array_input import as_numpy, is_empty
from warpqem.arguments.number_input import shown
from warpqem.arguments.progress import Progress
from warpqem.decimation.initial_quadrics import CONSTRAINT_WEIGHT, constraint_weights
from warpqem.errors import MeshShapeError, OptionError
from warpqem.mesh.edges import edge_table
from warpqem.mesh.mesh_input import AnimatedMesh, is_proper, read_faces
from warpqem.options import SimplifyKeywords, read_keywords
from warpqem.pipeline.prepare import prepare
from warpqem.pipeline.result import SimplifiedMesh, reached, without_frames
from warpqem.runtime.device import on_device
from warpqem.skinning.linear_skin import LinearSkin, read_poses, read_transforms

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = ["UNUSED_OPTIONS", "pulled_back_matrices", "simplify_pulled_back"]

# Options of `warpqem.simplify` that have no meaning for one rest shape without its poses.
UNUSED_OPTIONS = frozenset({"metric", "coherence", "key_frames", "placement", "quality", "refit", "memoryless"})

# Regularisation of a vertex towards the mean of its cluster, relative to its quadric: as in the order of collapses at
# coherence 0, enough for a solve where the surface is flat.
MEAN_REGULARISATION = 1e-3


@on_device
def simplify_pulled_back(
    points: Any,
    faces: Any,
    skin: LinearSkin,
    transforms: Any,
    *,
    progress: Progress | None = None,
    **options: Unpack[SimplifyKeywords],
) -> SimplifiedMesh:
    """Simplify a skinned mesh in its rest shape.

    Args:
        points: (P, V, 3), the mesh in its poses, the first of them the rest shape.
        faces: (N, 3) vertex indices.
        skin: its skin.
        transforms: (P, J, 3, 4), see :func:`warpqem.skinning.linear_skin.pose_skin`; identities in the first pose.
        options: ``ratio``, ``target_faces``, ``max_error``, ``vertex_weights``, ``quadric_scale``, ``locked``,
            ``lock_borders``, ``seams``, ``attributes``, ``memory`` and ``device`` of :func:`warpqem.simplify`;
            ``max_error`` limits the errors of single collapses here and is no bound on the distance.

    Returns:
        The result with one frame, the rest shape.

    Raises:
        The errors of :func:`warpqem.simplify`; OptionError for an option that has no meaning here.
    """
    unknown = UNUSED_OPTIONS & options.keys()
    if unknown:
        raise OptionError(f"{', '.join(sorted(unknown))}: no option of simplifying by pulled back quadrics")
    asked = read_keywords(options, metric="qem", coherence=0.0, quality="fast")
    poses = read_poses(points)
    corner = read_faces(faces, "faces", poses.shape[1])
    if not isinstance(skin, LinearSkin):
        raise OptionError(f"skin must be a LinearSkin, got {shown(skin)}")
    transforms = read_transforms(transforms, len(poses))
    if len(skin.checked(transforms.shape[1]).rest) != poses.shape[1]:
        raise MeshShapeError(f"the skin has {len(skin.rest)} points, the mesh {poses.shape[1]}")

    def summed_quadrics(mesh: AnimatedMesh, scale: np.ndarray) -> np.ndarray:
        """Those of all poses, pulled back, as a mean over poses."""
        own_poses, own_faces, own_skin, seams, repair = poses, corner, skin, asked.seams, mesh.repair
        if repair is not None:
            own_poses, own_skin = poses[:, repair.vertex], skin.checked(transforms.shape[1]).rows(repair.vertex)
            own_faces = mesh.faces
            seams = None if seams is None or is_empty(seams) else repair.edges(seams, own_faces)
        matrices = pulled_back_matrices(own_poses, own_faces, own_skin, transforms, seams)
        matrices *= scale[:, None, None] / (len(poses) * mesh.diagonal**2)
        return matrices

    work = prepare(poses[:1], corner, asked, quadrics=summed_quadrics, progress=progress)
    assert work.order_input is not None
    assert work.order_input.matrices is not None
    ordered = work.order(progress)
    placer = work.placer(ordered)
    repair = work.mesh.repair
    first = (poses[0] if repair is None else poses[0, repair.vertex]).astype(np.float64)
    rest = _place(first, placer.vertex_map, work.order_input.matrices, work.pinned | ordered.non_manifold)
    result = replace(
        without_frames(work, placer, ordered),
        log=ordered.log.made(),
        points=rest[None].astype(np.float32),
        flips=np.zeros(1, dtype=np.int32),
    )
    return reached(result, work.goal.target_faces)


def pulled_back_matrices(
    poses: np.ndarray, faces: np.ndarray, skin: LinearSkin, transforms: Any, seams: Any = None
) -> np.ndarray:
    """``sum_j L^T A L`` of every vertex, (V, 3, 3) float64, in the units of the points.

    Args:
        poses: (P, V, 3).
        faces: (N, 3).
        skin: the skin of the points.
        transforms: (P, J, 3, 4).
        seams: (S, 2) vertex pairs, or None; they count as in the order of collapses.
    """
    matrices = read_transforms(transforms, len(poses))
    skin = skin.checked(matrices.shape[1])
    faces = faces[is_proper(faces)]
    edges = edge_table(faces)
    line = _lines(edges.ends, edges.opposites, edges.face_count, seams, len(faces))
    total = np.zeros((len(skin.rest), 3, 3))
    for pose, transform in zip(poses, matrices, strict=True):
        point = pose.astype(np.float64)
        around = _vertex_matrices(point, faces, line)
        linear = np.einsum("vk,vkab->vab", skin.weights, transform[skin.joints][..., :3])
        total += np.einsum("vki,vkl,vlj->vij", linear, around, linear)
    return total


def _lines(
    ends: np.ndarray, opposites: np.ndarray, face_count: np.ndarray, seams: Any, all_faces: int
) -> list[tuple[np.ndarray, float]]:
    """Border and seam edges with a third vertex of each face there, and the weight of their planes."""
    border = face_count == 1
    lines = [(np.column_stack([ends[border], opposites[border, 0]]), CONSTRAINT_WEIGHT[1])]
    if seams is not None and not is_empty(seams):
        wanted = {tuple(sorted(pair)) for pair in as_numpy(seams, "seams").tolist()}
        on_seam = np.array([tuple(pair) in wanted for pair in ends.tolist()]) & (face_count == 2)
        weight = constraint_weights(int(on_seam.sum()), all_faces)[2]
        lines += [(np.column_stack([ends[on_seam], opposites[on_seam, k]]), weight) for k in range(2)]
    return lines


def _vertex_matrices(point: np.ndarray, faces: np.ndarray, lines: list[tuple[np.ndarray, float]]) -> np.ndarray:
    """``A`` of every vertex in one pose: its faces' planes by area, and those of border and seam edges."""
    total = np.zeros((len(point), 3, 3))
    cross = np.cross(point[faces[:, 1]] - point[faces[:, 0]], point[faces[:, 2]] - point[faces[:, 0]])
    length = np.linalg.norm(cross, axis=1)
    _add_planes(total, faces, cross, 0.5 / np.maximum(length, np.finfo(float).tiny))
    for triple, weight in lines:
        edge = point[triple[:, 1]] - point[triple[:, 0]]
        across = np.cross(edge, np.cross(edge, point[triple[:, 2]] - point[triple[:, 0]]))
        squared = np.maximum((across**2).sum(axis=1), np.finfo(float).tiny)
        _add_planes(total, triple[:, :2], across, weight * (edge**2).sum(axis=1) / squared)
    return total


def _add_planes(total: np.ndarray, vertices: np.ndarray, normal: np.ndarray, weight: np.ndarray) -> None:
    planes = np.einsum("f,fi,fj->fij", weight, normal, normal).reshape(-1, 9)
    width = vertices.shape[1]
    for entry in range(9):
        values = np.repeat(planes[:, entry], width)
        total.reshape(-1, 9)[:, entry] += np.bincount(vertices.ravel(), weights=values, minlength=len(total))


def _place(rest: np.ndarray, vertex_map: np.ndarray, matrices: np.ndarray, pinned: np.ndarray) -> np.ndarray:
    """The least of each cluster's summed quadrics, (C, 3); a pinned vertex stays."""
    used = np.flatnonzero(vertex_map >= 0)
    cluster, count = vertex_map[used], int(vertex_map.max()) + 1
    size = np.bincount(cluster, minlength=count)
    mean = (
        np.stack([np.bincount(cluster, weights=rest[used, k], minlength=count) for k in range(3)], axis=1)
        / size[:, None]
    )
    matrix, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(matrix, cluster, matrices[used])
    np.add.at(right, cluster, np.einsum("vij,vj->vi", matrices[used], rest[used] - mean[cluster]))
    regularisation = MEAN_REGULARISATION * np.trace(matrix, axis1=1, axis2=2) + np.finfo(float).tiny
    placed = mean + np.linalg.solve(matrix + regularisation[:, None, None] * np.eye(3), right[..., None])[..., 0]
    still = used[pinned[used] | (size[cluster] == 1)]
    placed[vertex_map[still]] = rest[still]
    return placed
