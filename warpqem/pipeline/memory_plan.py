"""The memory plan: what simplifying a mesh takes, in how many frames at a time, known before the work starts.

Decimation takes bytes per vertex and key frame, placing bytes per vertex and frame of a block; neither depends on the
number of frames. So there is a block size for any number of frames, and only two things can be too large: the key
frames, and what the caller wants back in memory. The factors were read off the arrays that the stages allocate, and
checked against the memory that processes took (benchmarks/NOTES.md).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

from warpqem.arguments.json_types import Json
from warpqem.errors import MemoryLimitError
from warpqem.frames.blocks import BLOCK_BYTES, block_width, chunk_frames
from warpqem.kernels.lanes import WIDE
from warpqem.pipeline.key_frames import MAX_LOOKED_FRAMES, pose_bytes
from warpqem.refit.material_frames import FRAME_BYTES
from warpqem.runtime.device import device_traits
from warpqem.runtime.memory import default_limit, format_bytes, parse_bytes

__all__ = [
    "KEPT_BYTES",
    "MemoryNeeds",
    "MemoryPlan",
    "admit_faces",
    "plan_memory",
    "stage_frames",
]


@dataclass(frozen=True)
class MemoryPlan:
    """How a mesh is going to be worked on.

    Attributes:
        frame_count: frames F that are placed.
        vertex_count: input vertices V.
        face_count: input faces N.
        key_frames: key frames K that decide which edges collapse.
        block_frames: frames placed at once.
        block_count: blocks of frames.
        limit_bytes: what the work may take, beside what the process holds already; None where the system does not say.
        held_bytes: what is held from beginning to end: topology, poses, frames that the source keeps, and the result
            where no sink takes it.
        order_bytes: what decimation takes on top.
        place_bytes: what placing takes on top, with the blocks that are being read and written meanwhile.
        scratch_bytes: size of the temporary file; 0 where there is none.
        device_frame_bytes: frames that stay on the device from reading to placing, a part of what is held; 0 where each
            block is brought there when it is needed.
        added_poses: how many of the frames are poses beside the animation: rest shape, blend shapes, examples.
    """

    frame_count: int
    vertex_count: int
    face_count: int
    key_frames: int
    block_frames: int
    block_count: int
    limit_bytes: int | None
    held_bytes: int
    order_bytes: int
    place_bytes: int
    scratch_bytes: int
    device_frame_bytes: int = 0
    added_poses: int = 0

    @property
    def peak_bytes(self) -> int:
        """The most that is taken at one time."""
        return self.held_bytes + max(self.order_bytes, self.place_bytes)

    def __str__(self) -> str:
        blocks = f"{self.block_count} block{'' if self.block_count == 1 else 's'} of {self.block_frames}"
        limit = "" if self.limit_bytes is None else f" of {format_bytes(self.limit_bytes)}"
        scratch = f", {format_bytes(self.scratch_bytes)} in a temporary file" if self.scratch_bytes else ""
        frames = f"{self.frame_count - self.added_poses} frames"
        if self.added_poses:
            frames += f" and {self.added_poses} pose{'s' * (self.added_poses != 1)} more"
        return (
            f"{self.vertex_count} vertices, {self.face_count} faces, {frames} in {blocks}, "
            f"{self.key_frames} key frames; memory {format_bytes(self.peak_bytes)}{limit} "
            f"(held {format_bytes(self.held_bytes)}, order {format_bytes(self.order_bytes)}, "
            f"place {format_bytes(self.place_bytes)}{scratch})"
        )

    def to_dict(self) -> dict[str, Json]:
        """Plain numbers, ready for JSON."""
        return {**asdict(self), "peak_bytes": self.peak_bytes}


@dataclass(frozen=True)
class MemoryNeeds:
    """What decides how much memory a mesh takes.

    Attributes:
        frame_count: frames F.
        vertex_count: input vertices V.
        face_count: input faces N.
        used_count: vertices with a face.
        key_frames: key frames K.
        output_vertices: output vertices C, or as many as there can be.
        value_bytes: bytes of a coordinate as it is read, 4 or 8.
        channels: attribute channels that the costs look at.
        trajectories: the costs need all frames of every vertex.
        refit: the result is refitted.
        exchanges: collapses are exchanged before.
        keep_frames: the result is kept in memory.
        keep_nodes: every vertex on the way down is kept, for levels that are placed later.
        memoryless: the quadrics of such levels are made anew, of their own faces.
        source_bytes: what the source of the frames keeps in memory.
        bounded: the distance to the input is proved.
        measured: the result is measured on its way to a sink.
        frames_there: the frames are on the device already, as they are needed.
    """

    frame_count: int
    vertex_count: int
    face_count: int
    used_count: int
    key_frames: int
    output_vertices: int
    value_bytes: int = 4
    channels: int = 0
    trajectories: bool = False
    refit: bool = False
    exchanges: bool = False
    keep_frames: bool = True
    keep_nodes: bool = False
    memoryless: bool = False
    source_bytes: int = 0
    bounded: bool = False
    measured: bool = False
    frames_there: bool = False

    @property
    def stage_frames(self) -> int:
        """Frames that the levels of a search within a limit are placed in, see :mod:`warpqem.pipeline.bounded`."""
        if 12 * self.frame_count * self.vertex_count <= KEPT_BYTES:
            return self.frame_count
        return min(stage_frames(self.vertex_count), self.frame_count)


def stage_frames(vertex_count: int) -> int:
    """Frames that a level is bounded in first: as many as are kept, within what is worth it."""
    return min(MAX_STAGE_FRAMES, max(WIDE, KEPT_BYTES // (12 * vertex_count)))


# Frames of so many bytes are kept, so that of the next level of a search only what has moved is placed.
KEPT_BYTES = 16 * 2**20
# Where there are many more frames, levels are bounded first in so many, far apart in pose: fewer take hardly less time,
# as many are looked at at once, and leave more steps to be done in all of them.
MAX_STAGE_FRAMES = 40
# Bytes per face and per vertex for the topology: the caller's faces checked, edges, flags, vertex map, log.
HELD_FACE, HELD_VERTEX = 60, 80
# While faces are read: their 32-bit copy, and that of those with three different vertices with the index of each.
READ_FACE = 28
# Decimation, for each face: corners, one-rings, costs and candidate lists, most of them twice; for each vertex:
# reservations, masks, flags, one-rings, cluster vertices and the log; for each vertex and key frame: position 12, the
# same as it was 12, and that in another order 12, quadric 40, and at first the normals of its two faces 24; for each
# corner and attribute channel: value, gradient, their fit; for each vertex and frame where the costs need them all: the
# position, and once more while vertices are permuted; then for each face and chunk of frames: area 4 and steps of the
# three edges 36, and as much to move them along.
ORDER_FACE, ORDER_VERTEX, ORDER_KEY, ORDER_CHANNEL, ORDER_TRAJECTORY, ORDER_CHUNK = 350, 174, 100, 200, 24, 80
# For levels that are placed later, for each vertex and key frame: position and quadric of each merged vertex; and while
# they are placed what decimation left, position before and after and quadric, and those of the level once more.
NODE_KEY, LEVEL_KEY = 52, 52 + 64 + 52
# For quadrics of a level's own faces, for each face: corners, their places and sorted copy, one-rings, seams and the
# keys that find these.
LEVEL_FACE = 120
# Placing, for each face: the rows of the clusters it has a part in, and what sorts them; for each output vertex: its
# anchor's Gram matrix of 32 x 33 / 2 numbers, and cluster vertices.
PLACE_FACE, PLACE_OUTPUT = 200, 2500
# A device that the host would wait for has room for three rows of each face, of 20 bytes, in place of some 1.5.
ROOM_FACE = 30
# A frame of a block, on a device with memory of its own: three buffers of pinned memory and a second block on the
# device for what is brought there; the same for what is brought back.
STAGED_VERTEX, STAGED_OUTPUT = 4 * 12, 4 * 12
# A frame of a block, for each output vertex: points and normals packed and not, as float64, as the caller's, and on
# their way to the sink.
FRAME_OUTPUT = 120
# The refit, for each input vertex and key frame: the surface on the device, on the host at first and in lanes then; for
# each input face and vertex: pairs, search hierarchies, what lies across its edges, lists by vertex and by cluster; for
# each output vertex: the pairs of its two faces and their equations, 9 blocks of 36 bytes each; for it and each
# key frame: where it was, its distance and the face that it is near to.
REFIT_KEY, REFIT_FACE, REFIT_VERTEX, REFIT_OUTPUT, REFIT_STEP = 24, 210, 160, 1700, 20
# The exchange of collapses, for each input vertex and key frame: what decimation left once more; and frame looked at:
# the points as read, about the origin and in blocks, and the level's, also in double precision; for each face: corners,
# distances, lists; on a device with memory of its own, what sorts the lists by vertex and by cluster, 24 each.
EXCHANGE_KEY, EXCHANGE_FRAME, EXCHANGE_FACE, EXCHANGE_SORT = 52, 100, 120, 48
# The proof of a distance, for each input face: pieces of 60 bytes, some five of both meshes for each, and once more
# while they are joined; what lies across edges and the search hierarchies. For each frame it looks at, and input
# vertex: the points as read and about the origin, in double precision, in blocks, and the level's; for each output
# vertex: these; for each input face: two bits of each of five pieces, in 32-bit words. The surface as placed keeps its
# pieces while the refitted one is proved.
BOUND_FACE, BOUND_VERTEX, BOUND_OUTPUT, BOUND_PIECES = 700, 60, 60, 6
BOUND_REFIT = 300
# Measuring, for each face of both meshes, in groups of frames of so many faces: corners, search hierarchies, patches
# and room for theirs, distances; and the samples.
MEASURE_FACE, MEASURE_GROUP, MEASURE_SAMPLES = 400, 2**14, 8 * 2**20


def plan_memory(needs: MemoryNeeds, limit: int | str | None, device: str) -> MemoryPlan:
    """Find the largest block of frames that fits.

    Args:
        needs: the mesh.
        limit: bytes, or text such as "8G"; None for most of what is free.
        device: Warp device.

    Raises:
        OptionError: the limit is no number of bytes.
        MemoryLimitError: no block fits, however small.
    """
    limit = default_limit(device) if limit is None else parse_bytes(limit)
    held = _held(needs)
    order = _order(needs, device)
    fixed, per_frame = _place(needs, device)
    if limit is not None and held + order > limit:
        raise MemoryLimitError(_refusal(needs, "ordering", held, order, limit))
    most = max(WIDE, BLOCK_BYTES // (12 * needs.vertex_count))
    if limit is not None:
        most = min(most, int((limit - held - fixed) // per_frame))
    # Whole vector registers; there is no less than one, which a shorter animation fills up too.
    block = most - most % WIDE
    if block < WIDE:
        raise MemoryLimitError(_refusal(needs, "placing", held, fixed + WIDE * per_frame, limit or 0))
    block = min(block, needs.frame_count)
    scratch = 0
    if needs.refit:
        stored = 12 * needs.frame_count * 3 * needs.output_vertices
        # What is stored may take what the blocks leave; beyond that it goes into a file.
        if limit is None or held + fixed + per_frame * max(block, WIDE) + stored <= limit:
            held += stored
        else:
            scratch = stored
    on_device = _device_frames(needs, device)
    if limit is not None and held + on_device + max(order, fixed + per_frame * max(block, WIDE)) > limit:
        on_device = 0
    held += on_device
    return MemoryPlan(
        frame_count=needs.frame_count,
        vertex_count=needs.vertex_count,
        face_count=needs.face_count,
        key_frames=needs.key_frames,
        block_frames=block,
        block_count=-(-needs.frame_count // block),
        limit_bytes=limit,
        held_bytes=held,
        order_bytes=order,
        place_bytes=fixed + per_frame * max(block, WIDE),
        scratch_bytes=scratch,
        device_frame_bytes=on_device,
    )


def admit_faces(face_count: int, limit: int | str | None, device: str) -> None:
    """Check that faces can be read at all, before a copy of them is made: the caller's may be one that is broadcast.

    Args:
        face_count: faces of the caller.
        limit: as for :func:`plan_memory`.
        device: likewise.

    Raises:
        OptionError: the limit is no number of bytes.
        MemoryLimitError: their copies alone take more.
    """
    bytes_allowed = default_limit(device) if limit is None else parse_bytes(limit)
    if bytes_allowed is not None and READ_FACE * face_count > bytes_allowed:
        raise MemoryLimitError(
            f"{face_count} faces need {format_bytes(READ_FACE * face_count)} of memory to be read, and "
            f"{format_bytes(bytes_allowed)} may be used"
        )


def _held(needs: MemoryNeeds) -> int:
    held = HELD_FACE * needs.face_count + HELD_VERTEX * needs.vertex_count + needs.source_bytes
    if needs.key_frames < needs.frame_count:
        held += pose_bytes(needs.frame_count, needs.used_count)
    return held + _result(needs)


def _result(needs: MemoryNeeds) -> int:
    return 12 * needs.frame_count * needs.output_vertices if needs.keep_frames else 0


def _device_frames(needs: MemoryNeeds, device: str) -> int:
    """All frames, on a device that has a copy of them anyway, unless that is the caller's."""
    if needs.frames_there:
        return 0
    return 12 * needs.frame_count * needs.vertex_count if device_traits(device).own_memory else 0


def _padded(frame_count: int, device: str) -> int:
    width = block_width(frame_count, device)
    return -(-frame_count // width) * width


def _order(needs: MemoryNeeds, device: str) -> int:
    per_vertex = ORDER_VERTEX + ORDER_KEY * _padded(needs.key_frames, device)
    if needs.keep_nodes:
        per_vertex += NODE_KEY * _padded(needs.key_frames, device)
    if needs.trajectories:
        per_vertex += ORDER_TRAJECTORY * needs.frame_count
    per_face = ORDER_FACE + 3 * ORDER_CHANNEL * needs.channels
    if needs.trajectories:
        per_face += ORDER_CHUNK * -(-needs.frame_count // chunk_frames(needs.frame_count, device))
    return per_vertex * needs.vertex_count + per_face * needs.face_count


def _place(needs: MemoryNeeds, device: str) -> tuple[int, int]:
    """Bytes whatever the block, and bytes for each frame of a block."""
    per_face = PLACE_FACE + ROOM_FACE * device_traits(device).own_memory
    fixed = per_face * needs.face_count + PLACE_OUTPUT * needs.output_vertices
    # The anchors are fitted on what decimation leaves: positions before and after, quadrics.
    anchors = 64 * _padded(needs.key_frames, device) * needs.vertex_count
    if needs.keep_nodes:
        fixed += LEVEL_KEY * _padded(needs.key_frames, device) * needs.vertex_count
        fixed += LEVEL_FACE * needs.face_count if needs.memoryless else 0
    # One block is packed while another is read, and copied where it is a caller's.
    per_frame = (3 * 3 * needs.value_bytes + 24) * needs.vertex_count + FRAME_OUTPUT * needs.output_vertices
    if device_traits(device).own_memory:
        per_frame += STAGED_VERTEX * needs.vertex_count + STAGED_OUTPUT * needs.output_vertices
    if needs.refit:
        refit = REFIT_KEY * needs.key_frames * needs.vertex_count
        refit += REFIT_FACE * needs.face_count + REFIT_VERTEX * needs.vertex_count
        fixed += refit + (REFIT_OUTPUT + REFIT_STEP * needs.key_frames) * needs.output_vertices
        per_frame += FRAME_BYTES * needs.output_vertices
    if needs.exchanges:
        looked = min(MAX_LOOKED_FRAMES, needs.frame_count)
        frames = EXCHANGE_KEY * _padded(needs.key_frames, device) + EXCHANGE_FRAME * _padded(looked, device)
        fixed += frames * needs.vertex_count
        fixed += (EXCHANGE_FACE + EXCHANGE_SORT * device_traits(device).own_memory) * needs.face_count
    if needs.bounded:
        bound = BOUND_VERTEX * needs.vertex_count + BOUND_OUTPUT * needs.output_vertices
        bound += BOUND_PIECES * needs.face_count
        fixed += BOUND_FACE * needs.face_count + needs.stage_frames * bound
        fixed += BOUND_REFIT * needs.face_count if needs.refit else 0
        per_frame += bound
    if needs.measured:
        fixed += 2 * MEASURE_FACE * max(needs.face_count, MEASURE_GROUP) + MEASURE_SAMPLES
    return max(fixed, anchors + PLACE_OUTPUT * needs.output_vertices), per_frame


def _refusal(needs: MemoryNeeds, stage: str, held: int, stage_bytes: int, limit: int) -> str:
    ways = []
    if needs.keep_frames and _result(needs) > limit // 10:
        ways.append("a sink for the frames, which then need not be kept")
    if needs.trajectories:
        ways.append("a metric other than dod, which holds every frame of every vertex")
    if stage == "ordering" and needs.key_frames > 1:
        ways.append(f"fewer key frames than {needs.key_frames}")
    if needs.refit:
        ways.append("no refit")
    return (
        f"{needs.vertex_count} vertices, {needs.face_count} faces and {needs.frame_count} frames need "
        f"{format_bytes(held + stage_bytes)} of memory for {stage}, and {format_bytes(limit)} may be used; "
        f"what would help: {', '.join([*ways, 'more memory'])}"
    )
