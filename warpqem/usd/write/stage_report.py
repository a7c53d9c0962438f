"""What happened to each mesh of a stage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from warpqem.measure.verdict import rank

__all__ = ["JointsReport", "PrimReport", "RunReport", "ShapesReport", "StageReport", "collapsed_note", "name_prim"]

# Times that a note names.
MAX_TIMES = 5


def name_prim(path: str, error: Exception) -> str:
    """The text of an error, with the prim it is about in front if it does not name it."""
    text = str(error)
    return text if text.startswith(path) else f"{path}: {text}"


def collapsed_note(path: str, times: Sequence[float] | None, frames: Sequence[int]) -> str:
    """What to say of frames, numbers into the times of a mesh, in which it is collapsed."""
    shown = [f"time {times[frame]:g}" if times else "its only pose" for frame in frames[:MAX_TIMES]]
    more = len(frames) - len(shown)
    names = ", ".join(shown) + (f" and {more} more" if more else "")
    return f"{path}: collapsed to a point or a line at {names}, left out of its errors"


@dataclass
class RunReport:
    """The outcome for one run of constant topology of a mesh whose topology varies over time.

    Attributes:
        first_time: Time code of its first frame.
        last_time: Time code of its last frame.
        frames: Number of its frames.
        faces_before: Triangles before.
        faces_after: Triangles after.
        measured: See `PrimReport`.
        estimate: See `PrimReport`.
        stopped: Why simplification stopped; None where it was kept.
    """

    first_time: float
    last_time: float
    frames: int
    faces_before: int
    faces_after: int
    measured: dict[str, Any] | None
    estimate: float | None
    stopped: str | None


@dataclass
class JointsReport:
    """Joints that went from a skinned mesh.

    Attributes:
        before: Joints that moved it before any went.
        after: Joints that move it.
        removed: Names of the others, in the order they went.
        heirs: The joint that got most of the weight of each; None where its points had found better ones before.
        added_error: RMS distance over the poses that this adds, in quadrature, in % of the rest shape's diagonal.
        counts: Joints at each step.
        errors: RMS distance over the poses at each of these counts, beyond that of the free placement, in %.
        influences: Joints that move a point at most.
    """

    before: int
    after: int
    removed: list[str]
    heirs: list[str | None]
    added_error: float
    counts: list[int]
    errors: list[float]
    influences: int


@dataclass
class ShapesReport:
    """Blend shapes that went from a mesh.

    Attributes:
        before: Blend shapes of the input.
        after: Those that stay.
        removed: Names of the others, in the order they went.
        merged: Of these, by name, how much of their weight which shapes took over.
        scales: What the offsets of shapes that stay were multiplied by, and their weights divided by, by name; those
            left out are as they were.
        used_error: RMS distance that this makes over the weights of the animation, in % of the rest shape's diagonal; 0
            without any.
        random_error: The same over random weights.
        counts: Blend shapes at each step.
        used_errors: `used_error` at each of these counts.
        random_errors: `random_error` at each of them.
    """

    before: int
    after: int
    removed: list[str]
    merged: dict[str, dict[str, float]]
    scales: dict[str, float]
    used_error: float
    random_error: float
    counts: list[int]
    used_errors: list[float]
    random_errors: list[float]


@dataclass
class PrimReport:
    """The outcome for one mesh.

    Attributes:
        path: Prim path.
        status: "simplified"; "kept" where nothing was to be removed, and the mesh is as in the input; or "failed".
        frames: Number of poses that were read.
        faces_before: Triangles before.
        faces_after: Triangles after.
        vertices_before: Points in use before.
        vertices_after: Points after.
        measured: The measured errors, see `warpqem.measure.Measured.to_dict`: `rms`, `hausdorff`, `flips`, `verdict`
            and others; None where the mesh was not simplified, or not measured.
        estimate: What the order of collapses takes for the error, in % of the bounding-box diagonal: the largest error
            of a collapse, which is neither a bound nor a measured distance.
        stopped: Why simplification stopped.
        components_removed: Small components of the surface that were pruned.
        seconds: Wall-clock time.
        dropped: What did not fit the new mesh and was taken off it.
        message: Why it failed, or why it was kept.
        skin: "fitted" or "interpolated: " and why, for a mesh that joints go on moving point by point; None for others.
        joints: Where joints were to go, what came of it, see `JointsReport`.
        shapes: Where blend shapes were to go, what came of it, see `ShapesReport`.
        symmetry: Where symmetry was asked for, "kept" or why the mesh is not symmetric.
        plan: The blocks of frames it was done in, and the memory for it, see `warpqem.MemoryPlan`.
        problems: Values that it was done with, but that cannot be meant, such as a normal that is no number.
        notes: What is worth knowing about how it was done.
        runs: The runs of constant topology, for a mesh whose topology varies over time; the counts above are then means
            over the frames. Empty for others.
    """

    path: str
    status: str
    frames: int = 0
    faces_before: int = 0
    faces_after: int = 0
    vertices_before: int = 0
    vertices_after: int = 0
    measured: dict[str, Any] | None = None
    estimate: float | None = None
    stopped: str | None = None
    components_removed: int = 0
    seconds: float = 0.0
    dropped: list[str] = field(default_factory=list)
    message: str | None = None
    skin: str | None = None
    joints: JointsReport | None = None
    shapes: ShapesReport | None = None
    symmetry: str | None = None
    plan: dict[str, Any] | None = None
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    runs: list[RunReport] = field(default_factory=list)


def _badness(prim: PrimReport) -> tuple[int, tuple[int, float]]:
    """What meshes are sorted by: the worst have the least."""
    if prim.status == "failed":
        return 0, (0, 0.0)
    if prim.measured is None:
        return 2, (0, 0.0)
    return 1, rank(prim.measured["verdict"], prim.measured["hausdorff"])


@dataclass
class StageReport:
    """The outcome for a stage.

    Attributes:
        input: Path of the file that was read.
        output: Path of the file that was written, the first of several; None if nothing was.
        prims: One report for each mesh, in stage order; instance proxies last.
        problems: What is wrong with how the input is composed, such as references to what is missing.
        notes: What is written in another place than it may be looked for at, such as meshes of instances.
        outputs: Paths of all files that were written, one for each level where that was asked for; not of textures.
        run: Versions, device, options, seconds and memory; see `warpqem.usd.commands.run_info`.
    """

    input: str
    output: str | None
    prims: list[PrimReport]
    problems: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)
    run: dict[str, Any] | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def failed(self) -> list[PrimReport]:
        """The meshes that could not be done."""
        return [prim for prim in self.prims if prim.status == "failed"]

    @property
    def worst_first(self) -> list[PrimReport]:
        """The meshes, those that failed first, then by verdict, then by the largest distance."""
        return sorted(self.prims, key=_badness)

    @property
    def face_share(self) -> float:
        """Triangles after per triangle before, of all meshes that could be read; 1 if there are none."""
        before = sum(prim.faces_before for prim in self.prims)
        return sum(prim.faces_after for prim in self.prims) / before if before else 1.0

    def to_dict(self) -> dict[str, Any]:
        """Plain dictionaries, lists, numbers and None, ready for JSON."""
        return asdict(self)
