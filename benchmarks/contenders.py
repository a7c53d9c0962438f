"""Who takes part: warpqem and what a user would pick instead. Each takes all frames and gives all frames.

Two ways are open to a tool that knows one frame only: simplify each frame alone, which gives every frame its own
topology; or simplify the first frame to some of its vertices and let the other frames follow. The second needs a tool
that says which input vertices an output vertex stands for; pyfqmr does not.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import c_float, c_size_t, c_uint
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.simplified import Simplified
from benchmarks.work import Work

__all__ = ["BASE", "CONTENDERS", "FAST", "STATIC", "Contender"]

# The one whose time the others' are divided by.
BASE, FAST = "warpqem", "warpqem, fast"
# Above any error a mesh can have, in its own units: the face count alone shall stop meshoptimizer.
NO_ERROR_LIMIT = 1.0e9
# Principal components of the motion that become vertex attributes: the most that meshoptimizer takes.
ATTRIBUTES = 32
# Weight of those attributes beside the position, both relative to the mesh's extent: of 0.5, 1, 2, 5, 10 and 20 the one
# with the lowest RMS on the quadruped.
ATTRIBUTE_WEIGHT = 10.0

Frame = tuple[NDArray[Any], NDArray[Any]]


@dataclass(frozen=True)
class Contender:
    """One way to do the work.

    Attributes:
        package: distribution whose version is reported.
        way: what it does with the frames.
        run: does it; called with the work and the Warp device.
    """

    package: str
    way: str
    run: Callable[[Work, str | None], Simplified]


def _warpqem(quality: Literal["best", "fast"]) -> Callable[[Work, str | None], Simplified]:
    def run(work: Work, device: str | None) -> Simplified:
        import warpqem

        result = warpqem.simplify(
            work.points, work.faces, target_faces=work.target_faces, quality=quality, device=device
        )
        return Simplified(list(result.points), [result.faces])

    return run


def _subset(points: NDArray[np.float32], faces: NDArray[Any]) -> Simplified:
    """All frames of the input vertices that the faces refer to."""
    used, corners = np.unique(faces, return_inverse=True)
    return Simplified(list(points[:, used]), [corners.reshape(-1, 3).astype(np.int32)])


def _meshoptimizer_frame(points: NDArray[np.float32], faces: NDArray[np.int32], target: int) -> NDArray[np.uint32]:
    import meshoptimizer

    indices = faces.astype(np.uint32).ravel()
    kept = np.empty_like(indices)
    count = meshoptimizer.simplify(kept, indices, points, target_index_count=3 * target, target_error=NO_ERROR_LIMIT)
    return kept[:count].reshape(-1, 3)


def _meshoptimizer_carried(work: Work, _: str | None) -> Simplified:
    return _subset(work.points, _meshoptimizer_frame(work.points[0], work.faces, work.target_faces))


def _meshoptimizer_per_frame(work: Work, _: str | None) -> Simplified:
    frames = [_subset(p[None], _meshoptimizer_frame(p, work.faces, work.target_faces)) for p in work.points]
    return Simplified([f.points[0] for f in frames], [f.faces[0] for f in frames])


def _motion_components(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """(V, A) coordinates of each vertex's displacements from the first frame in their leading principal components."""
    motion = (points[1:] - points[0]).transpose(1, 0, 2).reshape(points.shape[1], -1).astype(np.float64)
    motion -= motion.mean(axis=0)
    _, directions = np.linalg.eigh(motion.T @ motion)
    return (motion @ directions[:, ::-1][:, :ATTRIBUTES]).astype(np.float32)


def _meshoptimizer_attributes(work: Work, device: str | None) -> Simplified:
    import meshoptimizer

    if len(work.points) == 1:
        return _meshoptimizer_carried(work, device)
    indices = work.faces.astype(np.uint32).ravel()
    kept = np.empty_like(indices)
    # Errors are sums over attributes: divided by the frames they stand for, one frame's displacement counts as one.
    extent = np.ptp(work.points[0], axis=0).max() * np.sqrt(len(work.points) - 1)
    attributes = np.ascontiguousarray(_motion_components(work.points) / extent)
    # The wrapper hands numbers to the C function without saying what they are, so they come as C types.
    count = meshoptimizer.simplify_with_attributes(
        kept,
        indices,
        np.ascontiguousarray(work.points[0]),
        attributes,
        np.full(attributes.shape[1], ATTRIBUTE_WEIGHT, dtype=np.float32),
        index_count=c_size_t(len(indices)),
        vertex_count=c_size_t(len(attributes)),
        vertex_positions_stride=c_size_t(12),
        vertex_attributes_stride=c_size_t(4 * attributes.shape[1]),
        attribute_count=c_size_t(attributes.shape[1]),
        target_index_count=c_size_t(3 * work.target_faces),
        target_error=c_float(NO_ERROR_LIMIT),
        options=c_uint(0),
    )
    return _subset(work.points, kept[:count].reshape(-1, 3))


def _fast_simplification_frame(points: NDArray[np.float32], faces: NDArray[np.int32], target: int) -> Frame:
    import fast_simplification

    return fast_simplification.simplify(points, faces, target_count=target)


def _pyfqmr_frame(points: NDArray[np.float32], faces: NDArray[np.int32], target: int) -> Frame:
    import pyfqmr

    tool = pyfqmr.Simplify()
    tool.setMesh(points, faces)
    tool.simplify_mesh(target_count=target, verbose=False)
    simplified, kept, _ = tool.getMesh()
    return simplified, kept


def _per_frame(simplify: Callable[..., Frame]) -> Callable[[Work, str | None], Simplified]:
    def run(work: Work, _: str | None) -> Simplified:
        frames = [simplify(p, work.faces, work.target_faces) for p in work.points]
        return Simplified([p for p, _ in frames], [f for _, f in frames])

    return run


def _fast_simplification_carried(work: Work, _: str | None) -> Simplified:
    import fast_simplification

    first = work.points[0]
    *_, collapses = fast_simplification.simplify(
        first, work.faces, target_count=work.target_faces, return_collapses=True
    )
    points, faces, cluster = fast_simplification.replay_simplification(first, work.faces, collapses)
    # Of the input vertices that became an output vertex, the one nearest to it stands for it. The nearest of all
    # vertices would not do: where parts touch in the first frame it may be on another leg.
    distance = np.linalg.norm(points[cluster] - first, axis=1)
    order = np.lexsort((distance, cluster))
    member = order[np.unique(cluster[order], return_index=True)[1]].astype(np.int32)
    return _subset(work.points, member[faces])


CONTENDERS = {
    BASE: Contender("warpqem", "all frames, one topology", _warpqem("best")),
    FAST: Contender("warpqem", "all frames, one topology, quality fast", _warpqem("fast")),
    "meshoptimizer, per frame": Contender("meshoptimizer", "each frame alone", _meshoptimizer_per_frame),
    "meshoptimizer, carried": Contender("meshoptimizer", "first frame, others follow", _meshoptimizer_carried),
    "meshoptimizer, attributes": Contender(
        "meshoptimizer", "first frame, motion as attributes", _meshoptimizer_attributes
    ),
    "fast-simplification, per frame": Contender(
        "fast-simplification", "each frame alone", _per_frame(_fast_simplification_frame)
    ),
    "fast-simplification, carried": Contender(
        "fast-simplification", "first frame, others follow", _fast_simplification_carried
    ),
    "pyfqmr, per frame": Contender("pyfqmr", "each frame alone", _per_frame(_pyfqmr_frame)),
}

# With one frame there is nothing to carry.
STATIC = [name for name in CONTENDERS if name in (BASE, FAST) or name.endswith("per frame")]
