"""One mesh made ready for simplification: its frames, its seams, and what deforms it."""

from __future__ import annotations

import weakref
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Sdf, Usd

from warpqem.frames.blocks import frame_blocks
from warpqem.frames.stream import ArrayFrames, FrameSource, JoinedFrames, KeptFrames, read_ahead
from warpqem.pipeline.result import SimplifiedMesh
from warpqem.pipeline.surface_transfer import SurfaceTransfer
from warpqem.repair.mended_mesh import MeshRepair, face_repair
from warpqem.runtime.memory import parse_bytes
from warpqem.usd.commands.rig_options import single
from warpqem.usd.commands.simplify_options import SimplifyOptions
from warpqem.usd.read.blend_shapes import choose_targets
from warpqem.usd.read.mesh_seams import MeshSeams, find_seams
from warpqem.usd.read.mesh_skin import Skin, read_skin
from warpqem.usd.read.read_mesh import MeshLayout, MeshSource, PoseFrames
from warpqem.usd.read.weld import weld
from warpqem.usd.write.attribute_transfer import AttributeTransfer

__all__ = ["MeshJob", "RestFit"]

# Poses of up to so many bytes are kept once they have been read: as much as USD and Warp take themselves.
KEPT_BYTES = 64 * 2**20
# Where memory is limited they take one part in so many of it at most.
KEPT_PART = 8


@dataclass(frozen=True)
class RestFit:
    """A scaling and a move that bring the rest shape to the size and place of the poses.

    The skeleton may work in other units than the mesh; frames of another size would count for more, or for nothing.
    """

    scale: float
    rest_centre: npt.NDArray[np.float64]
    pose_centre: npt.NDArray[np.float64]

    @classmethod
    def of(cls, rest: npt.NDArray[np.float32], pose: npt.NDArray[np.float32]) -> RestFit:
        """What brings this rest shape (V, 3) to the size and place of this pose (V, 3)."""
        extents = [np.ptp(points.astype(np.float64), axis=0) for points in (rest, pose)]
        sizes = [float(np.linalg.norm(extent)) for extent in extents]
        centres = [points.min(axis=0) + extent / 2 for points, extent in zip((rest, pose), extents, strict=True)]
        return cls(sizes[1] / sizes[0] if min(sizes) > 0 else 1.0, centres[0], centres[1])

    def apply(self, points: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
        """Rest points as large as the poses."""
        return ((points - self.rest_centre) * self.scale + self.pose_centre).astype(np.float32)

    def moved(self, transforms: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Transforms (..., 3, 4) of rest points, for rest points that this has been applied to."""
        linear = transforms[..., :3] / self.scale
        origin = self.rest_centre - self.pose_centre / self.scale
        return np.concatenate([linear, transforms[..., 3:] + (transforms[..., :3] @ origin)[..., None]], axis=-1)

    def undo(self, points: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
        """Such points as large as the rest shape again."""
        return ((points - self.pose_centre) / self.scale + self.rest_centre).astype(np.float32)


class KeptSurfaces:
    """What was found on the input for the last result that was asked for: a skin is fitted by it, and written by it."""

    def __init__(self) -> None:
        """Nothing is found yet."""
        self._result: weakref.ref[SimplifiedMesh] | None = None
        self._found: dict[bytes, SurfaceTransfer] = {}

    def of(self, result: SimplifiedMesh) -> dict[bytes, SurfaceTransfer]:
        """By seams, for `AttributeTransfer`."""
        if self._result is None or self._result() is not result:
            self._result, self._found = weakref.ref(result), {}
        return self._found


@dataclass(frozen=True)
class MeshJob:
    """One mesh made ready.

    Attributes:
        source: The mesh on the stage.
        mesh: Its triangles and when it is posed.
        faces: int32, shape (N, 3), its triangles on welded vertices; those that welding closed name a vertex twice.
        seams: Its seams.
        skin: What goes on deforming it; None for poses as point samples.
        unskinned_because: Why a skin is there but cannot be taken over; None if it can, or there is none.
        frames: E + F frames of the welded vertices in use: first E that only say how the mesh is shaped, then the
            poses. These E are the rest shape of a mesh with a skin and its blend shapes at full weight, or example
            poses of one without.
        pose_start: E.
        rest_fit: What brought the rest shape of a mesh with a skin to the poses; None without one.
        repair: What simplifying mends of the topology first; None for nothing.
        examples: The same mesh in example poses; None without any.
        surfaces: What `transfer` has found.
    """

    source: MeshSource
    mesh: MeshLayout
    faces: npt.NDArray[np.int32]
    seams: MeshSeams
    skin: Skin | None
    unskinned_because: str | None
    frames: FrameSource
    pose_start: int
    rest_fit: RestFit | None
    repair: MeshRepair | None = None
    examples: MeshSource | None = None
    surfaces: KeptSurfaces = field(default_factory=KeptSurfaces)

    @classmethod
    def prepare(
        cls,
        source: MeshSource,
        options: SimplifyOptions | None = None,
        *,
        shape_users: Counter[Sdf.Path] | None = None,
        examples: MeshSource | None = None,
    ) -> MeshJob:
        """Read a mesh.

        Args:
            source: The mesh.
            options: How to read it: their `frames`, `bake`, `weld`, `influences` and `memory`; None for the defaults.
            shape_users: How many meshes use each BlendShape prim of the stage; None if each has one.
            examples: The same mesh in example poses. They take the place of the poses of a mesh with a skin, and come
                before those of one without.

        Raises:
            StageError: a pose cannot be read.
        """
        options = options or SimplifyOptions(ratio=1.0)
        skin, reason = None, None
        if not options.bake and len(source.topology.triangles):
            skin, reason = read_skin(source, shape_users or Counter(), single(options.influences))
        mesh = source.layout(source.frame_times(options.frames, baked=skin is None))
        if not len(mesh.faces):
            frames = PoseFrames(source, mesh.times, mesh.used_points)
            return cls(source, mesh, mesh.faces, MeshSeams(), None, None, frames, 0, None)
        clips = [(source, mesh.times)]
        if examples is not None:
            clips.insert(0, (examples, examples.frame_times()))
        joined: np.ndarray = np.arange(len(mesh.used_points))
        if options.weld:
            shown = [PoseFrames(*clip, mesh.used_points) for clip in clips]
            joined = weld(mesh.faces, _what_moves(mesh, skin, shown))
        kept, vertex = np.unique(joined, return_inverse=True)
        vertex_point, faces = mesh.used_points[kept], vertex.ravel().astype(np.int32)[mesh.faces]
        repair = face_repair(faces, len(vertex_point))
        seams = find_seams(
            source,
            faces,
            repair=repair,
            welded=len(vertex_point) < len(mesh.used_points),
            # Normals of a rest shape fit no pose, so that they are dropped where poses are written.
            with_normals=skin is not None or not source.has_skin_binding,
        )
        memory = None if options.memory is None else parse_bytes(options.memory)
        poses = [_kept_if_small(PoseFrames(*clip, vertex_point), memory) for clip in clips]
        if skin is None:
            start = sum(part.frame_count for part in poses[:-1])
            return cls(source, mesh, faces, seams, None, reason, JoinedFrames(poses), start, None, repair, examples)
        # Examples take the place of the mesh's own poses.
        rest = skin.rest_points[vertex_point]
        targets = [rest + offsets[vertex_point] for offsets in choose_targets(skin.shapes)]
        fit = RestFit.of(rest, poses[0].read(slice(0, 1))[0])
        extra = fit.apply(np.stack([rest, *targets]))
        shapes = JoinedFrames([ArrayFrames(extra), poses[0]])
        return cls(source, mesh, faces, seams, skin, None, shapes, len(extra), fit, repair, examples)

    @property
    def pose_count(self) -> int:
        """How many of `frames` are poses."""
        return self.frames.frame_count - self.pose_start

    @property
    def has_own_poses(self) -> bool:
        """False where `frames` has example poses in place of the mesh's own."""
        return self.skin is None or self.examples is None

    @property
    def written_times(self) -> list[float] | None:
        """Times of the points to write: those of the poses; None for the rest shape of a mesh with a skin."""
        return self.mesh.times if self.rest_fit is None else None

    @property
    def streams(self) -> bool:
        """Whether poses are written while they are placed; a single one, and a rest shape, the result has."""
        return self.skin is None and self.frames.frame_count > 1

    def is_simplified_by(self, result: SimplifiedMesh) -> bool:
        """Whether anything was removed."""
        return len(result.log) > 0 or len(result.faces) < len(self.mesh.faces)

    def rest_shape(self, result: SimplifiedMesh) -> npt.NDArray[np.float32]:
        """The rest shape of a mesh with a skin, simplified: float32, shape (1, V', 3)."""
        assert self.rest_fit is not None
        return self.rest_fit.undo(result.points[:1])

    def transfer(self, result: SimplifiedMesh, device: str | None) -> AttributeTransfer:
        """Where the simplified mesh gets its values from."""
        reference = self.frames.read(slice(0, 1))[0]
        surfaces = self.surfaces.of(result)
        transfer = AttributeTransfer(self.source, self.faces, reference, result, self.seams, device, surfaces)
        transfer.read_pose = self._read_written
        if self.skin is not None:
            times = [None] if self.mesh.times is None else self.mesh.times
            transfer.shown_codes = [Usd.TimeCode.Default() if time is None else Usd.TimeCode(time) for time in times]
            transfer.read_shown = self._read_shown
        return transfer

    def _read_shown(self, pose: int) -> npt.NDArray[np.float32]:
        """The vertices (V, 3) in one of the mesh's own poses."""
        if self.has_own_poses:
            frame = self.pose_start + pose
            return self.frames.read(slice(frame, frame + 1))[0]
        point = np.empty(self.frames.vertex_count, dtype=np.int32)
        point[self.faces] = self.source.topology.triangles
        return PoseFrames(self.source, self.mesh.times, point).read(slice(pose, pose + 1))[0]

    def _read_written(self, pose: int) -> npt.NDArray[np.float32]:
        """The vertices (V, 3) in one of the poses that are written, as large as they are written."""
        if self.rest_fit is not None:
            return self.rest_fit.undo(self.frames.read(slice(0, 1))[0])
        frame = self.pose_start + pose
        return self.frames.read(slice(frame, frame + 1))[0]


def _kept_if_small(frames: PoseFrames, memory: int | None) -> FrameSource:
    """Poses that fit in little memory are read once, and skinned or interpolated once."""
    kept = KeptFrames(frames)
    most = KEPT_BYTES if memory is None else min(KEPT_BYTES, memory // KEPT_PART)
    return kept if kept.held_bytes <= most else frames


def _what_moves(mesh: MeshLayout, skin: Skin | None, clips: Sequence[PoseFrames]) -> Iterator[npt.NDArray[Any]]:
    """Everything that points must agree in to be one vertex: (V, ...) each; first what is in memory already."""
    if skin is not None:
        yield skin.rest_points[mesh.used_points]
        for influences in skin.influences.values():
            yield influences.joints[mesh.used_points]
            yield influences.weights[mesh.used_points]
        for shape in skin.shapes:
            for name, array in shape.arrays.items():
                # Normal offsets are values on the surface; they do not move it.
                if not name.endswith("normalOffsets"):
                    yield array[mesh.used_points]
    for clip in clips:
        for _, points in read_ahead(clip.read, frame_blocks(clip.frame_count, clip.vertex_count)):
            yield from points
