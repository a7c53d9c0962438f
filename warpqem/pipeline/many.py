"""``warpqem.simplify_many``: many meshes in one call, several at once."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, cast, overload

from warpqem.arguments.array_types import ArrayInput, MeshPoints
from warpqem.arguments.number_input import flag, shown
from warpqem.arguments.progress import CancelToken, Progress, ProgressInput, listener, share_of, with_progress_bar
from warpqem.costs.models import cost_model
from warpqem.errors import CancelledError, MemoryLimitError, OptionError, WarpqemError
from warpqem.options import MeshOptions, SimplifyKeywords, read_keywords
from warpqem.pipeline.prepare import check_metric_options
from warpqem.pipeline.result import SimplifiedMesh
from warpqem.pipeline.simplify import simplify
from warpqem.runtime.cpu_threads import thread_count
from warpqem.runtime.device import device_traits, resolve_device
from warpqem.runtime.memory import available_memory, parse_bytes

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = ["ManyMeshes", "simplify_many"]

# Meshes at once. Half of the work on a small one holds the interpreter's lock, so that more threads would wait; large
# ones are split over all cores each.
MAX_AT_ONCE = 4
# Options of which each mesh may have its own in place of those for all.
GOALS = ("ratio", "target_faces", "max_error", "max_distance")
# Seconds between two looks at how far the meshes are.
LOOK = 0.1

OneMesh = MeshPoints | tuple[MeshPoints, ArrayInput] | tuple[MeshPoints, ArrayInput, SimplifyKeywords]
ManyMeshes = Iterable[OneMesh]


@overload
def simplify_many(
    meshes: ManyMeshes,
    *,
    return_errors: Literal[False] = False,
    progress: ProgressInput = None,
    cancel: CancelToken | None = None,
    **options: Unpack[SimplifyKeywords],
) -> list[SimplifiedMesh]: ...


@overload
def simplify_many(
    meshes: ManyMeshes,
    *,
    return_errors: bool,
    progress: ProgressInput = None,
    cancel: CancelToken | None = None,
    **options: Unpack[SimplifyKeywords],
) -> list[SimplifiedMesh | WarpqemError]: ...


@with_progress_bar
def simplify_many(
    meshes: ManyMeshes,
    *,
    return_errors: bool = False,
    progress: ProgressInput = None,
    cancel: CancelToken | None = None,
    **options: Unpack[SimplifyKeywords],
) -> list[SimplifiedMesh] | list[SimplifiedMesh | WarpqemError]:
    """Simplify many meshes, each as :func:`simplify` alone does, to the bit.

    On a CPU several are worked on at once, a GPU takes one after the other. Files of many meshes are a matter of
    ``warpqem.usd.simplify_stage``, and many files one of :func:`warpqem.batch`, which gives each a process.

    Args:
        meshes: each ``(points, faces)``, or ``(points, faces, options)`` with options of its own that go before those
            given for all; or what :func:`simplify` takes without faces.
        return_errors: give the error of a mesh in the place of its result, and go on, also where it is its own options
            that are wrong; else the first one in order is raised, and those behind it are not done. What a function of
            yours raises, such as a ``metric``, ends the call either way.
        progress: called in this thread with the part done, 0 to 1, and how many meshes are; True for a bar.
        cancel: ends the call from another thread, such as a ``threading.Event``.
        options: as for :func:`simplify`; ``memory`` is for all that are at work at once.

    Returns:
        A result for each mesh, in order.

    Raises:
        OptionError: an argument or an option for all is wrong; names of meshes in messages are ``meshes[17]``.
        WarpqemError: the errors of :func:`simplify` for a mesh, which the message names, unless ``return_errors``.
        CancelledError: ``cancel`` was set.

    Examples:
        The second mesh has a ratio of its own:

        >>> import numpy as np, trimesh, warpqem
        >>> ball = trimesh.creation.icosphere(subdivisions=3)
        >>> points = np.stack([ball.vertices * (1, 1, 1 + 0.2 * step) for step in range(4)])
        >>> meshes = [(points, ball.faces), (points[:1], ball.faces, {"ratio": 0.2})]
        >>> [len(result.faces) for result in warpqem.simplify_many(meshes, ratio=0.1)]
        [128, 256]
    """
    keep_errors = flag(return_errors, "return_errors")
    listen = listener(progress, cancel)
    given = [_read_mesh(index, mesh, options, keep_errors) for index, mesh in enumerate(_listed(meshes))]
    _check_common(options)
    if not given:
        return []
    # One device for all: they take turns on it.
    devices = {mesh.device for mesh in given if isinstance(mesh, _Asked)} or {resolve_device(options.get("device"))}
    workers = max(thread_count(device) if device_traits(device).splits_launches else 1 for device in devices)
    workers = min(workers, len(given), MAX_AT_ONCE)
    at_work = _Work(given, workers, _memory_share(options, next(iter(devices)), workers), keep_errors, cancel)
    return at_work.run(listen)


def _listed(meshes: Any) -> list[Any]:
    if isinstance(meshes, (str, bytes, dict)) or not isinstance(meshes, Iterable):
        raise OptionError(f"meshes must be a list of (points, faces), got {shown(meshes)}")
    return list(meshes)


@dataclass(frozen=True)
class _Asked:
    """A mesh with its options."""

    points: Any
    faces: Any
    keywords: SimplifyKeywords
    device: str


def _read_mesh(index: int, mesh: Any, common: SimplifyKeywords, keep_errors: bool) -> _Asked | WarpqemError:
    """Points, faces and options of a mesh, or its error where errors are results."""
    try:
        with _named(index):
            return _asked(mesh, common)
    except WarpqemError as error:
        if not keep_errors:
            raise
        return error


def _asked(mesh: Any, common: SimplifyKeywords) -> _Asked:
    points, faces, own = mesh, None, cast("SimplifyKeywords", {})
    if isinstance(mesh, tuple):
        if len(mesh) not in (2, 3):
            raise OptionError(f"expected (points, faces) or (points, faces, options), got a tuple of {len(mesh)}")
        points, faces = mesh[:2]
        own = mesh[2] if len(mesh) == 3 else own
    if not isinstance(own, dict):
        raise OptionError(f"options must be a dictionary, got {shown(own)}")
    _check_own_names(own)
    # A goal of its own takes the place of that for all.
    kept = {name: value for name, value in common.items() if name not in GOALS or not own.keys() & set(GOALS)}
    keywords = cast("SimplifyKeywords", {**kept, **own})
    asked = read_keywords(keywords)
    check_metric_options(asked, cost_model(asked.metric))
    if asked.memory is not None:
        parse_bytes(asked.memory)
    return _Asked(points, faces, keywords, resolve_device(asked.device))


def _check_own_names(own: Mapping[Any, Any]) -> None:
    """Raise an OptionError for an option that there is not: a dictionary is a value, like others of a mesh."""
    names = [entry.name for entry in fields(MeshOptions)]
    for name in own:
        if name not in names:
            raise OptionError(f"there is no option {shown(name)}; the options are {', '.join(names)}")


def _check_common(options: SimplifyKeywords) -> None:
    """Check what is asked of all meshes, also where there is none, or each has options of its own."""
    # Each may have a goal of its own.
    goal = {} if any(options.get(name) is not None for name in GOALS) else {"ratio": 1.0}
    asked = read_keywords(cast("SimplifyKeywords", {**options, **goal}))
    spec = cost_model(asked.metric)
    check_metric_options(asked, spec)
    resolve_device(asked.device)
    if asked.memory is not None:
        parse_bytes(asked.memory)


def _memory_share(options: SimplifyKeywords, device: str, workers: int) -> int | None:
    """Bytes for each of the meshes at work at once; None where nobody knows how much there is."""
    asked = options.get("memory")
    limit = available_memory(device) if asked is None else parse_bytes(asked)
    return None if limit is None or workers == 1 else max(1, limit // (2 * workers if asked is None else workers))


@contextmanager
def _named(index: int) -> Iterator[None]:
    """Put the place of a mesh before the messages of its errors."""
    try:
        yield
    except (WarpqemError, TypeError) as error:
        if not isinstance(error, CancelledError):
            error.args = (f"meshes[{index}]: {error}", *error.args[1:])
        raise


@dataclass(frozen=True)
class _Token:
    """Ends the work on one mesh: the caller cancels all, or one before it has failed."""

    work: _Work
    index: int

    def is_set(self) -> bool:
        return self.work.is_over(self.index)


class _Work:
    """Meshes at work, in several threads.

    Args:
        meshes: points, faces and options of each, or the error that its options are.
        workers: threads.
        memory: bytes for each of the meshes at work at once; None for what it would take alone.
        keep_errors: errors are results.
        cancel: ends all.
    """

    def __init__(
        self,
        meshes: Sequence[_Asked | WarpqemError],
        workers: int,
        memory: int | None,
        keep_errors: bool,
        cancel: CancelToken | None,
    ) -> None:
        self._meshes, self._workers, self._memory = meshes, workers, memory
        self._keep_errors, self._cancel = keep_errors, cancel
        # The first mesh in order that has failed; those behind it need not be done.
        self._failed = len(meshes)
        self._lock = threading.Lock()
        self._done = [0.0] * len(meshes)

    def is_over(self, index: int) -> bool:
        """Whether nobody waits for a mesh any more."""
        return index > self._failed or (self._cancel is not None and self._cancel.is_set())

    def run(self, progress: Progress | None) -> list[Any]:
        """All results in order."""
        results = self._one_by_one(progress) if self._workers == 1 else self._at_once(progress)
        for result in results[: self._failed + 1]:
            if isinstance(result, CancelledError) or (isinstance(result, WarpqemError) and not self._keep_errors):
                raise result
        if progress is not None:
            progress(1.0, self._text(len(results)))
        return results

    def _one_by_one(self, progress: Progress | None) -> list[Any]:
        results: list[Any] = []
        for index in range(len(self._meshes)):
            whole = None if progress is None else share_of(progress, index / len(self._meshes), 1 / len(self._meshes))
            # A GPU needs the host for each pass where somebody listens.
            token = None if self._cancel is None else _Token(self, index)
            show = None if whole is None else partial(self._show, whole, index)
            results.append(self._simplify(index, None, show, token))
            if self.is_over(index + 1):
                break
        return results

    def _show(self, whole: Progress, index: int, fraction: float, _: str) -> None:
        whole(fraction, self._text(index))

    def _at_once(self, progress: Progress | None) -> list[Any]:
        with ThreadPoolExecutor(self._workers, thread_name_prefix="warpqem-mesh") as pool:
            futures = [
                pool.submit(self._simplify, index, self._memory, partial(self._note, index), _Token(self, index))
                for index in range(len(self._meshes))
            ]
            try:
                self._watch(futures, progress)
            except BaseException:
                # What the caller's function raises, Ctrl-C, or the token.
                self._failed = -1
                raise
        results = [future.result() for future in futures]
        for index, result in enumerate(results[: self._failed]):
            # Alone it may take all memory.
            if isinstance(result, MemoryLimitError):
                results[index] = self._simplify(index, None, None, None)
        return results

    def _note(self, index: int, fraction: float, _: str) -> None:
        self._done[index] = fraction

    def _watch(self, futures: Sequence[Future[Any]], progress: Progress | None) -> None:
        left: set[Future[Any]] = set(futures)
        while left:
            _, left = wait(left, None if progress is None else LOOK, FIRST_COMPLETED)
            if progress is not None:
                progress(sum(self._done) / len(futures), self._text(len(futures) - len(left)))

    def _text(self, done: int) -> str:
        return f"{done} of {len(self._meshes)} meshes"

    def _simplify(
        self, index: int, memory: int | None, progress: Progress | None, cancel: CancelToken | None
    ) -> SimplifiedMesh | WarpqemError:
        """The result of a mesh, or its error."""
        mesh = self._meshes[index]
        if not isinstance(mesh, _Asked):
            self._done[index] = 1.0
            return mesh
        keywords = mesh.keywords
        if memory is not None:
            own = keywords.get("memory")
            keywords = cast(
                "SimplifyKeywords", {**keywords, "memory": memory if own is None else min(memory, parse_bytes(own))}
            )
        try:
            with _named(index):
                return simplify(mesh.points, mesh.faces, progress=progress, cancel=cancel, **keywords)
        except Exception as error:
            # For want of memory it has its turn again, alone.
            again = memory is not None and isinstance(error, MemoryLimitError)
            if not (again or (self._keep_errors and isinstance(error, WarpqemError))):
                with self._lock:
                    self._failed = min(self._failed, index)
            if not isinstance(error, WarpqemError):
                raise
            return error
        finally:
            self._done[index] = 1.0
