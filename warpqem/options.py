"""The options of simplifying, each with its range, unit and help; command line, manifests and batches derive theirs.

:class:`MethodOptions` are those of a mesh wherever it comes from, :class:`MeshOptions` add what
:func:`warpqem.simplify` takes as arrays, ``warpqem.usd.SimplifyOptions`` what a stage has names for.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Literal, TypedDict

from warpqem.arguments.array_types import ArrayInput
from warpqem.arguments.limits import ABOVE_0, COUNT, SHARE, Limits
from warpqem.arguments.option_fields import check_options, option
from warpqem.costs.models import Metric, cost_model, cost_model_names
from warpqem.errors import OptionError

if TYPE_CHECKING:
    from warpqem.arguments.distance_limit import DistanceLimit
    from warpqem.costs.attributes import AttributeField
    from warpqem.costs.motion_features import MotionWeighting
    from warpqem.face.protect import FaceProtection

__all__ = [
    "Goal",
    "LevelKeywords",
    "MeshOptions",
    "MethodKeywords",
    "MethodOptions",
    "SimplifyKeywords",
    "check_ratio",
    "read_goal",
    "read_keywords",
    "target_count",
]


@dataclass(frozen=True)
class Goal:
    """Where simplifying ends.

    Attributes:
        target_faces: faces to keep; 0 to go on until the error limit.
        max_error: % of the diagonal; inf for none.
        max_distance: in units of the points; inf for none.
    """

    target_faces: int
    max_error: float
    max_distance: float = math.inf

    @property
    def limit(self) -> DistanceLimit:
        """How far the result may be from the input."""
        from warpqem.arguments.distance_limit import DistanceLimit

        return DistanceLimit(self.max_error / 100.0, self.max_distance)


@dataclass(frozen=True)
class MethodOptions:
    """How a mesh is simplified, wherever it comes from.

    Attributes:
        ratio: share of the faces to keep, in (0, 1], to the nearest whole number.
        max_error: the largest distance between the input and the result, both ways, at every point and in every frame,
            in % of the diagonal of the input's bounding box in that frame. It is proved, not sampled
            (:mod:`warpqem.kernels.distance_bound`), for the result as it is returned; single spots are held back where
            they would be too far (:mod:`warpqem.pipeline.bounded`), which takes several times as long as a result by
            count.
        max_size_error: where to stop above the face count or within a limit, so that a small mesh is not destroyed: no
            edge collapses whose error, an estimate as in ``SimplifiedMesh.error``, would pass so many % of the diagonal
            of the mesh's bounding box. Nothing is proved or searched for, as it is with ``max_error``. None for no
            limit.
        quality: "best" orders by quadrics of the present faces, exchanges collapses where the surface is furthest from
            the input (:mod:`warpqem.pipeline.exchange`) and fits the whole surface at the end, see ``memoryless`` and
            ``refit``: a better shape in four to six times the time of "fast", which does none of it.
        metric: cost model: "dsd" (default), "qem", "dod", "aqem", "face", or the name of one of another package; a
            :class:`warpqem.costs.CostModelSpec`; or a function of key frames (K, V, 3) and faces (N, 3) that gives
            factors (V,) on the cost at each vertex. See :mod:`warpqem.costs.models`.
        coherence: 0 (every frame its own best fit) to 1 (vertices stay on the material).
        refit: fit the surface as a whole to the input after placing its vertices, see
            :mod:`warpqem.refit.fit_surface`: a better shape for about the time of the rest. No effect with "endpoint".
            None for what ``quality`` says.
        memoryless: order by quadrics of the present faces instead of the input's: a better shape in about 1.5 to 2
            times the time, best together with ``refit``; see :mod:`warpqem.kernels.memoryless_quadric`. None for what
            ``quality`` says.
        placement: "optimal", or "endpoint" to use vertices of the input only.
        key_frames: how many frames decide the order, chosen by their pose; None for all.
        lock_borders: lock the vertices at edges with one face too.
        keep_components: no component is pruned. Otherwise those are, as a whole, of which collapses have left four
            faces or fewer, or that have no cheap collapse left, such as rings, where the shape misses that less than
            the next collapses, and where no other collapse is legal; the result may then have fewer faces than asked
            for, by up to three or by those of such a ring. A locked vertex keeps its component.
        memory: bytes that the work may take, beside what the process holds already, or text such as "8G"; None for
            most of what is free. It decides how many frames are in memory at once, and no bit of the result.
        device: Warp device; None takes cuda:0 if present, else cpu.
    """

    ratio: float | None = option(
        None, "Share of its triangles that each mesh keeps.", "SHARE", SHARE, basic=True, panel="Goal"
    )
    max_error: float | None = option(
        None,
        "Largest distance of each mesh from the input, in % of its bounding-box diagonal, proved for every point and "
        "pose, with about the fewest faces; of a skinned mesh as its skin has it, if that is linear.",
        "PCT",
        ABOVE_0,
        brief="Largest distance from the input, in % of its diagonal, proved for every point and pose",
        basic=True,
        panel="Goal",
    )
    max_size_error: float | None = option(
        None,
        "A mesh stops where the estimate of its error would pass so many % of its bounding-box diagonal, whatever the "
        "goal.",
        "PCT",
        ABOVE_0,
        panel="Goal",
    )
    quality: Literal["fast", "best"] = option(
        "best",
        "best orders by the present faces, exchanges collapses where the surface is furthest from the input, and fits "
        "it at the end, see --memoryless and --refit; fast does none of it, in a fifth of the time and with a worse "
        "shape.",
        brief="fast takes about a fifth of the time, with a worse shape",
        basic=True,
        panel="Quality",
    )
    metric: Metric = option(
        "dsd",
        "Cost model: dsd sums the error over frames (Mohr & Gleicher 2003), qem takes the first pose only (Garland & "
        "Heckbert 1997), dod adds stretching edges (Huang, Chen & Chuang), aqem keeps joints (Yang et al. 2019), face "
        "keeps the feature points of a face. Installed packages may offer more.",
        choices=cost_model_names,
        panel="Quality",
    )
    coherence: float = option(
        0.5,
        "0 to 1: 0 fits every frame on its own, 1 lets vertices stick to the surface over time.",
        "SHARE",
        Limits(0.0, 1.0),
        panel="Quality",
    )
    refit: bool | None = option(
        None,
        "Fit the whole surface once more at the end: better shape, slower. By default as --quality says.",
        panel="Quality",
    )
    memoryless: bool | None = option(
        None,
        "Order by planes of the present faces instead of the input's (Lindstrom & Turk 1998): better shape, slower. By "
        "default as --quality says.",
        panel="Quality",
    )
    placement: Literal["optimal", "endpoint"] = option(
        "optimal", "Merged vertices at the optimal point, or at an endpoint of the edge.", panel="Quality"
    )
    key_frames: int | None = option(
        16, "Number of frames, different in pose, that decide the topology.", "FRAMES", COUNT, panel="Quality"
    )
    lock_borders: bool = option(False, "Keep the points of open borders.", panel="What to keep")
    keep_components: bool = option(
        False, "Prune no small component, even if the shape would miss it less than others.", panel="What to keep"
    )
    memory: int | str | None = option(
        None,
        "Memory that the work on a mesh may take beside the program itself, such as 8G or 500M; by default most of "
        "what is free. It decides how many frames are in memory at once, and no bit of the result.",
        "BYTES",
        panel="Machine",
    )
    device: str | None = option(
        None, "Warp device, such as cpu or cuda:0; by default the GPU if there is one.", "NAME", panel="Machine"
    )

    @property
    def refits(self) -> bool:
        """Whether the surface is fitted once more; with endpoints vertices of the input are to stay what they are."""
        wanted = self.quality == "best" if self.refit is None else bool(self.refit)
        return wanted and self.placement != "endpoint"

    @property
    def exchanges(self) -> bool:
        """Whether collapses are exchanged before the refit, see :mod:`warpqem.pipeline.exchange`."""
        return self.refits and self.quality == "best"

    @property
    def memoryless_orders(self) -> bool:
        """Whether quadrics are those of the present faces."""
        return self.quality == "best" if self.memoryless is None else bool(self.memoryless)

    def method(self) -> MethodKeywords:
        """These options but for the goals, as keyword arguments of :func:`warpqem.simplify`."""
        names = {entry.name for entry in fields(MethodOptions)} - {"ratio", "max_error", "max_size_error"}
        return {name: getattr(self, name) for name in sorted(names)}  # type: ignore[return-value]  # a field each


@dataclass(frozen=True)
class MeshOptions(MethodOptions):
    """What decides the result of :func:`warpqem.simplify` for a mesh.

    Attributes:
        target_faces: faces to keep, at least 1. The result has as many, or one fewer. At least one of ``ratio``,
            ``target_faces``, ``max_error`` and ``max_distance`` is needed; of several, whichever comes first stops.
        max_distance: the limit of ``max_error`` in units of the points, whatever size the mesh has in a frame.
        vertex_weights: (V,) factors from 0 to 1e12 on the cost at each vertex; infinity locks it. A merged vertex gets
            the mean of its ends'.
        quadric_scale: (V,) factors from 0 to 1e12 on each vertex's own quadric (Kho & Garland 2003), which stay with
            its planes as they add up; see :func:`warpqem.costs.morph_weights`. Vertices are placed by the
            scaled quadrics.
        locked: (V,) bool, or indices, of vertices that keep their position in every frame.
        seams: (S, 2) vertex pairs: edges that values on the surface do not cross, such as UV seams. They stay closed
            polylines of edges near where they were, with the same ends and forks, as long as the shape has something
            to spare: beyond that the islands between them that cost the shape least are given up.
        attributes: UVs and other values on the surface, each with the weight of its error in the order of collapses;
            see :class:`warpqem.costs.AttributeField`. ``max_error`` and ``SimplifiedMesh.error`` stay errors of the
            shape.
        face: how ``metric="face"`` keeps the feature points of a face, see :class:`warpqem.face.FaceProtection`; None
            for its defaults.
        motion: how ``metric="aqem"`` finds the joints and what they weigh, see :class:`warpqem.costs.MotionWeighting`;
            None for the ways of its paper.
    """

    target_faces: int | None = option(None, "Faces to keep.", "FACES", COUNT)
    max_distance: float | None = option(
        None, "Largest distance of the result from the input, in units of the points.", "UNITS", ABOVE_0, panel="Goal"
    )
    vertex_weights: ArrayInput | None = None
    quadric_scale: ArrayInput | None = None
    locked: ArrayInput | None = None
    seams: ArrayInput | None = None
    attributes: Sequence[AttributeField] = ()
    face: FaceProtection | None = None
    motion: MotionWeighting | None = None

    def checked(self) -> MeshOptions:
        """The same with Python's own numbers and flags.

        Raises:
            OptionError: an option of the wrong type or outside its range; goals that are missing or exclude each other.
        """
        if self.ratio is None and self.target_faces is None and not self.bounded:
            raise OptionError("one of ratio, target_faces, max_error and max_distance is needed")
        if self.ratio is not None and self.target_faces is not None:
            raise OptionError(f"ratio {self.ratio} and target_faces {self.target_faces} exclude each other")
        if not isinstance(self.metric, str):
            cost_model(self.metric)
        return replace(self, **check_options(self), attributes=_checked_fields(self.attributes))

    def goal(self, face_count: int) -> Goal:
        """Where simplifying a mesh of so many faces ends."""
        goal = read_goal(face_count, self.ratio, self.target_faces, self.max_error)
        return goal if self.max_distance is None else replace(goal, max_distance=self.max_distance)

    @property
    def bounded(self) -> bool:
        """Whether the distance to the input is limited."""
        return self.max_error is not None or self.max_distance is not None


class MethodKeywords(TypedDict, total=False):
    """Keyword arguments that say how :func:`warpqem.simplify` works: :class:`MeshOptions` without the goals."""

    quality: Literal["fast", "best"]
    metric: Metric
    coherence: float
    refit: bool | None
    memoryless: bool | None
    placement: Literal["optimal", "endpoint"]
    key_frames: int | None
    lock_borders: bool
    keep_components: bool
    memory: int | str | None
    device: str | None
    vertex_weights: ArrayInput | None
    quadric_scale: ArrayInput | None
    locked: ArrayInput | None
    seams: ArrayInput | None
    attributes: Sequence[AttributeField]
    face: FaceProtection | None
    motion: MotionWeighting | None


class LevelKeywords(MethodKeywords, total=False):
    """The same with the limit that levels of a mesh share."""

    max_size_error: float | None


class SimplifyKeywords(LevelKeywords, total=False):
    """Keyword arguments of :func:`warpqem.simplify`, for type checkers: the fields of :class:`MeshOptions`."""

    ratio: float | None
    target_faces: int | None
    max_error: float | None
    max_distance: float | None


def read_keywords(keywords: SimplifyKeywords | MethodKeywords, **goals: Any) -> MeshOptions:
    """Checked options from keyword arguments.

    Raises:
        TypeError: there is no such option.
        OptionError: as for :meth:`MeshOptions.checked`.
    """
    names = [entry.name for entry in fields(MeshOptions)]
    for name in keywords:
        if name not in names:
            raise TypeError(f"unexpected keyword argument {name!r}; the options are {', '.join(names)}")
    return MeshOptions(**keywords, **goals).checked()


def _checked_fields(attributes: Any) -> tuple[AttributeField, ...]:
    from warpqem.arguments.number_input import shown

    # An iterator would be empty the second time it is looked at.
    if not isinstance(attributes, (list, tuple)):
        raise OptionError(f"attributes must be a list of AttributeField, got {shown(attributes)}")
    for index, field in enumerate(attributes):
        if not (hasattr(field, "values") and hasattr(field, "weight")):
            raise OptionError(f"attributes[{index}] must be an AttributeField, got {shown(field)}")
    return tuple(attributes)


def check_ratio(ratio: Any) -> float:
    """The part of the faces that is asked for.

    Raises:
        OptionError: it is none.
    """
    from warpqem.arguments.number_input import number_within

    return number_within(ratio, "ratio", SHARE)


def target_count(ratio: float, face_count: int) -> int:
    """The faces that a part of them is, to the nearest whole number: of 72 faces 0.3 are 22.

    Everywhere it is a part of the faces that the caller gave, with those that repeat others.
    """
    return max(1, round(ratio * face_count))


def read_goal(face_count: int, ratio: float | None, target_faces: int | None, max_error: float | None) -> Goal:
    """With an error limit alone, ordering goes on until the limit stops it."""
    target = int(target_faces or 0) if ratio is None else target_count(ratio, face_count)
    return Goal(target, math.inf if max_error is None else max_error)


if not TYPE_CHECKING:  # to a type checker every name would exist

    def __getattr__(name: str) -> Any:
        # The name before 0.2, which `warpqem.usd` has for another class; gone in 0.3.
        if name == "SimplifyOptions":
            warnings.warn("warpqem.options.SimplifyOptions is now MeshOptions", DeprecationWarning, stacklevel=2)
            return MeshOptions
        raise AttributeError(f"module 'warpqem.options' has no attribute {name!r}")
