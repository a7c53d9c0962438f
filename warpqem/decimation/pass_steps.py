"""The steps of a pass, recorded once and replayed in every pass, and the arrays that they hand each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import warp as wp

from warpqem.decimation.adjacency import Adjacency
from warpqem.decimation.collapse_log import new_log
from warpqem.decimation.initial_quadrics import CONSTRAINT_WEIGHT
from warpqem.decimation.recorded_launches import (
    LaunchGroup,
    RecordedLaunches,
    new_edge_list,
    part_work,
    record_shared,
    run_once,
)
from warpqem.kernels import collapse as collapse_kernels
from warpqem.kernels import deformation as deformation_kernels
from warpqem.kernels import edge_cost as cost_kernels
from warpqem.kernels import independent_set as set_kernels
from warpqem.kernels import legality as legality_kernels
from warpqem.kernels import memoryless_quadric as memoryless_kernels
from warpqem.kernels.lanes import width_of
from warpqem.kernels.mesh_state import AnyKeyFrames, CostModel, MeshState
from warpqem.kernels.work import EdgeList
from warpqem.runtime import new_arrays
from warpqem.runtime.cpu_threads import thread_count
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import Recorder

__all__ = ["ROUNDS", "PassLaunches", "PassSteps"]

# Rounds of reservations a pass; each selects collapses among the candidates that the earlier ones left free.
ROUNDS = 3

# A face may turn over in this part of the key frames (crumpling motion); 1 of 16.
FLIP_FRACTION = 0.07
HISTOGRAM_BINS = 4096
# Stretches of bins that a thread each looks through, and each of which a thread adds up: the work of both is the same.
HISTOGRAM_STRETCHES = 128


@dataclass(frozen=True)
class PassLaunches:
    """The steps of a pass, recorded for a number of parts. Rounds take turns with two lists of candidates."""

    collect: RecordedLaunches
    choose: tuple[RecordedLaunches, RecordedLaunches]
    commit: tuple[RecordedLaunches, RecordedLaunches]
    build_adjacency: RecordedLaunches
    update_adjacency: RecordedLaunches
    renew: RecordedLaunches
    candidates: tuple[EdgeList, EdgeList]
    selected: EdgeList
    legal: wp.array


class PassSteps:
    """What the passes over one mesh state are made of.

    Attributes:
        threads: CPU threads that large steps are split over.
        log: the collapses so far.
        log_rows: where its arrays lie, see :func:`warpqem.decimation.collapse_log.new_log`.
        pass_number, pass_begin: (1,) int32, the pass at work, and the length of the log when it began.
        wanted: (1,) int32, edges that a pass is to look at.
        sample_step: (1,) int32, the cost threshold is read off every so many half-edges.
        cost_threshold: (1,) float32, the cost that candidates stay below.
        faces_removed: int32, the faces that each selected collapse removes; 0 for an illegal one.
        target: (S, B) blocks of points, where each selected collapse puts its vertex.
        anchor, error: (S,) float32, the anchor along its edge, and the mean squared error of what it merges.
        mask: (V,) int32, the last pass that masked each vertex.
        flip_tolerance: key frames in which a face may turn over.
        lists: room (3N,) int32 for the two lists of candidates that rounds take turns with, and for the selected ones.

    Args:
        memoryless: quadrics are those of the present faces.
    """

    def __init__(
        self,
        state: MeshState,
        frames: AnyKeyFrames,
        adjacency: Adjacency,
        model: CostModel,
        device: str,
        memoryless: bool = False,
        seam_weight: float = CONSTRAINT_WEIGHT[2],
    ) -> None:
        self.state, self.frames, self.adjacency, self.model, self.device = state, frames, adjacency, model, device
        self._width, self._memoryless = width_of(frames.position), memoryless
        self._seam_weight = seam_weight
        face_count = len(state.corner_vertex) // 3
        vertex_count = len(state.vertex_flags)
        self.flip_tolerance = int(FLIP_FRACTION * model.key_count)
        self.threads = thread_count(device)
        self.log, self.log_rows = new_log(vertex_count, device)
        self.pass_number, self.pass_begin, self.wanted, self.sample_step = (self.integers(1) for _ in range(4))
        self.cost_threshold = new_arrays.zeros(1, dtype=wp.float32, device=device)
        self._reservation = new_arrays.full(vertex_count, set_kernels.UNRESERVED, dtype=wp.int64, device=device)
        self.mask, self._updated = self.integers(vertex_count), self.integers(vertex_count)
        # Selected edges share no vertex, so there are V / 2 at most; an edge stands at one of its two half-edges.
        max_selected = vertex_count // 2 + 1
        self.lists = [new_arrays.empty(3 * face_count, dtype=wp.int32, device=device) for _ in range(3)]
        self.faces_removed = self.integers(max_selected)
        shape = (max_selected, frames.position.shape[1])
        self.target = new_arrays.empty(shape, dtype=frames.position.dtype, device=device)
        self.anchor, self.error = (new_arrays.empty(max_selected, dtype=wp.float32, device=device) for _ in range(2))
        self._launches: dict[int, PassLaunches] = {}

    def integers(self, count: int) -> wp.array:
        """(count,) int32 zeros."""
        return new_arrays.zeros(count, dtype=wp.int32, device=self.device)

    def compute_all_costs(self) -> None:
        """Compute all costs by the model as it is now."""

        def compute_costs(recorder: Recorder, part: int) -> None:
            work = part_work(part, self.threads, self.device)
            record_shared(
                recorder, cost_kernels.compute_all_costs[self._width], [self.state, self.frames, self.model], work
            )

        measured = self._measuring(deformation_kernels.measure_all_deformation, [self.state])
        run_once([*measured, LaunchGroup(compute_costs, self.threads)], self.device)

    def _measuring(self, kernel: wp.Kernel, inputs: list[Any]) -> list[LaunchGroup]:
        """Measure anew what the deformation term sums over all frames; nothing where there is none."""

        def measure(recorder: Recorder, part: int) -> None:
            record_shared(recorder, kernel, inputs, part_work(part, self.threads, self.device))

        return [LaunchGroup(measure, self.threads)] if self.model.deformation_weight > 0 else []

    def launches(self, part_count: int) -> PassLaunches:
        """The steps for so many parts, recorded when they are first asked for."""
        if part_count not in self._launches:
            candidates = tuple(new_edge_list(storage, part_count) for storage in self.lists[:2])
            selected = new_edge_list(self.lists[2], part_count)
            legal, space, slot, pool_slot = (self.integers(part_count) for _ in range(4))
            choose, commit = [], []
            for now, left in ((candidates[0], candidates[1]), (candidates[1], candidates[0])):
                choose.append(
                    [
                        self._emptying(selected),
                        *self.selecting(now, selected, part_count),
                        *self.checking(selected, legal, space, part_count),
                    ]
                )
                commit.append(
                    [
                        self._opening(legal, space, slot, pool_slot),
                        self._emptying(left),
                        *self.committing(selected, self.faces_removed, slot, pool_slot, part_count),
                        *self.shrinking(now, left, part_count),
                    ]
                )
            histogram = new_arrays.zeros((part_count, HISTOGRAM_BINS), dtype=wp.int32, device=self.device)
            self._launches[part_count] = PassLaunches(
                collect=self._recorded(
                    [
                        LaunchGroup(lambda recorder, _: recorder.copy(self.pass_begin, self.log.count)),
                        self._emptying(candidates[0]),
                        *self.collecting(candidates[0], histogram, part_count),
                    ]
                ),
                choose=(self._recorded(choose[0]), self._recorded(choose[1])),
                commit=(self._recorded(commit[0]), self._recorded(commit[1])),
                build_adjacency=self._recorded(self.adjacency.launch_groups(part_count)),
                update_adjacency=self._recorded(self.updating_adjacency(part_count)),
                renew=self._recorded(self.renewing(part_count)),
                candidates=candidates,
                selected=selected,
                legal=legal,
            )
        return self._launches[part_count]

    def forget_launches(self) -> None:
        """Have the steps recorded anew: recorded ones know the model as it was."""
        self._launches.clear()

    def _recorded(self, groups: Sequence[LaunchGroup]) -> RecordedLaunches:
        return RecordedLaunches(groups, self.device)

    @staticmethod
    def _emptying(edges: EdgeList) -> LaunchGroup:
        return LaunchGroup(lambda recorder, _: recorder.zero(edges.count))

    def collecting(self, candidates: EdgeList, histogram: wp.array, part_count: int) -> list[LaunchGroup]:
        """Fill an empty list of candidates with the cheapest edges; ``histogram`` is zero between passes."""
        state = self.state

        def count(recorder: Recorder, part: int) -> None:
            work = part_work(part, part_count, self.device)
            record_shared(recorder, set_kernels.count_costs, [state, self.sample_step], work, [histogram])

        def find_cost_threshold(recorder: Recorder, _: int) -> None:
            inputs = [self.wanted, self.sample_step]
            if device_traits(self.device).in_order:
                recorder.launch(set_kernels.find_cost_threshold, 1, inputs, [histogram, self.cost_threshold])
                return
            sums, cheapest, edge_count = (self.integers(n) for n in (HISTOGRAM_STRETCHES, 1, 1))
            outputs = [histogram, self.cost_threshold, cheapest, edge_count]
            recorder.launch(set_kernels.sum_bins, len(sums), [histogram], [sums])
            recorder.launch(set_kernels.find_threshold_by_sums, len(sums), [*inputs, sums], outputs)
            recorder.launch(set_kernels.bound_threshold, 1, [edge_count, cheapest], [self.cost_threshold])

        def collect(recorder: Recorder, part: int) -> None:
            work = part_work(part, part_count, self.device)
            record_shared(recorder, set_kernels.collect_candidates, [state, self.cost_threshold], work, [candidates])

        return [LaunchGroup(count, part_count), LaunchGroup(find_cost_threshold), LaunchGroup(collect, part_count)]

    def selecting(self, candidates: EdgeList, selected: EdgeList, part_count: int) -> list[LaunchGroup]:
        """Select collapses that share no vertex of their one-rings, into the empty list ``selected``."""
        state = self.state

        def reservation(recorder: Recorder, part: int) -> None:
            work = part_work(part, part_count, self.device)
            record_shared(recorder, set_kernels.reserve_vertices, [state, candidates], work, [self._reservation])

        def select(recorder: Recorder, part: int) -> None:
            work = part_work(part, part_count, self.device)
            record_shared(
                recorder, set_kernels.select_collapses, [state, candidates, self._reservation], work, [selected]
            )

        def clear(recorder: Recorder, part: int) -> None:
            work = part_work(part, part_count, self.device)
            record_shared(recorder, set_kernels.clear_reservations, [state, candidates], work, [self._reservation])

        return [LaunchGroup(record, part_count) for record in (reservation, select, clear)]

    def checking(self, selected: EdgeList, legal: wp.array, space: wp.array, part_count: int) -> list[LaunchGroup]:
        """Place and check the selected collapses.

        ``legal`` and ``space`` count the legal ones of each part, and the pool entries of their adjacency; empty
        where nobody asks.
        """
        state, frames = self.state, self.frames

        def check(recorder: Recorder, part: int) -> None:
            work = part_work(part, part_count, self.device)
            placed = [state, frames, self.model, selected]
            targets = [self.target, self.anchor]
            record_shared(recorder, legality_kernels.place_collapses[self._width], placed, work, targets)
            checked = [*placed, self.target, self.flip_tolerance]
            outputs = [self.faces_removed, self.error, legal, space]
            record_shared(recorder, legality_kernels.check_collapses[self._width], checked, work, outputs)

        return [LaunchGroup(check, part_count)]

    def _opening(self, legal: wp.array, space: wp.array, slot: wp.array, pool_slot: wp.array) -> LaunchGroup:
        """Reserve room for what was counted, from the first slot of each part on."""
        outputs = [legal, space, self.log, slot, self.state.adjacency.used, pool_slot]
        return LaunchGroup(lambda recorder, _: recorder.launch(collapse_kernels.open_log, 1, [], outputs))

    def committing(
        self, selected: EdgeList, faces_removed: wp.array, slot: wp.array, pool_slot: wp.array, part_count: int
    ) -> list[LaunchGroup]:
        """Apply the collapses that remove faces.

        ``slot`` and ``pool_slot`` count up from the first free places of each part, in the log and the adjacency pool.
        """
        state, frames = self.state, self.frames

        def commit(recorder: Recorder, part: int) -> None:
            work = part_work(part, part_count, self.device)
            checked = [faces_removed, self.target, self.anchor, self.error]
            inputs = [state, frames, selected, *checked, self.pass_number]
            outputs = [self.mask, self.log, slot, pool_slot]
            record_shared(recorder, collapse_kernels.commit_collapses[self._width], inputs, work, outputs)

        return [LaunchGroup(commit, part_count)]

    def shrinking(self, candidates: EdgeList, candidates_left: EdgeList, part_count: int) -> list[LaunchGroup]:
        """Keep the candidates that a round leaves free, in an empty list."""

        def shrink(recorder: Recorder, part: int) -> None:
            work = part_work(part, part_count, self.device)
            inputs = [self.state, self.mask, self.pass_number, self.cost_threshold, candidates]
            record_shared(recorder, set_kernels.shrink_candidates, inputs, work, [candidates_left])

        return [LaunchGroup(shrink, part_count)]

    def updating_adjacency(self, part_count: int) -> list[LaunchGroup]:
        """Bring the adjacency of opposite vertices up to date; that of moved vertices is since the commit."""

        def remove_dead(recorder: Recorder, part: int) -> None:
            work = part_work(part, part_count, self.device)
            inputs = [self.state, self.log, self.pass_begin, self.pass_number]
            record_shared(recorder, collapse_kernels.remove_dead_corners, inputs, work, [self._updated])

        return [LaunchGroup(remove_dead, part_count)]

    def renewing(self, part_count: int, cost_parts: int | None = None) -> list[LaunchGroup]:
        """Update the costs of what moved, resume edges around it. Costs are worth all threads, or ``cost_parts``."""
        state = self.state
        cost_parts = self.threads if cost_parts is None else cost_parts

        def update_costs(recorder: Recorder, part: int) -> None:
            work = part_work(part, cost_parts, self.device)
            inputs = [state, self.frames, self.model, self.log, self.pass_begin]
            record_shared(recorder, cost_kernels.update_moved_costs[self._width], inputs, work)

        def resume(recorder: Recorder, part: int) -> None:
            work = part_work(part, part_count, self.device)
            record_shared(recorder, cost_kernels.resume_neighbourhoods, [state, self.mask, self.pass_number], work)

        moved = [state, self.log, self.pass_begin]
        measured = self._measuring(deformation_kernels.move_trajectories, moved)
        measured += self._measuring(deformation_kernels.measure_moved_deformation, moved)
        if self._memoryless:
            return [*measured, *self._renewing_quadrics(cost_parts)]
        return [*measured, LaunchGroup(update_costs, cost_parts), LaunchGroup(resume, part_count)]

    def _renewing_quadrics(self, cost_parts: int) -> list[LaunchGroup]:
        """Make the quadrics around what moved anew, and the costs of all edges there."""
        weights = memoryless_kernels.LineWeights()
        weights.border, weights.seam = CONSTRAINT_WEIGHT[1], self._seam_weight
        around = [self.mask, self.pass_number]

        def renew(recorder: Recorder, part: int) -> None:
            work = part_work(part, cost_parts, self.device)
            inputs = [self.state, self.frames, weights, *around]
            record_shared(recorder, memoryless_kernels.renew_quadrics[self._width], inputs, work)

        def update_costs(recorder: Recorder, part: int) -> None:
            work = part_work(part, cost_parts, self.device)
            inputs = [self.state, self.frames, self.model, *around]
            record_shared(recorder, cost_kernels.update_neighbourhood_costs[self._width], inputs, work)

        return [LaunchGroup(renew, cost_parts), LaunchGroup(update_costs, cost_parts)]
