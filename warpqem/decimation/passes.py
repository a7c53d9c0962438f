"""The parallel pass: cost threshold, candidates, rounds of reservation and commit, until the target is met.

A pass: update the costs of what moved, find the cost threshold, collect the candidates under it, then for a few rounds:
reserve, select, place, check, commit; at last bring the adjacency up to date. Here the host goes from pass to pass,
which suits a CPU; on a GPU :mod:`warpqem.decimation.device_loop` does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from warpqem.decimation.collapse_nodes import NodeRecorder
from warpqem.decimation.ordering import Ordering
from warpqem.decimation.pass_steps import ROUNDS, PassLaunches, PassSteps
from warpqem.decimation.pruning import Components
from warpqem.kernels import attribute as attribute_kernels
from warpqem.kernels import collapse as collapse_kernels
from warpqem.kernels import deformation as deformation_kernels
from warpqem.kernels import pass_control as control_kernels
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import launch
from warpqem.runtime.part_launches import corners_of, launch_in_parts, rows_of

__all__ = ["SHARED_FACES", "Orderer"]

CANDIDATE_FRACTION, FRACTION_GROWTH = float(control_kernels.CANDIDATE_FRACTION), float(control_kernels.FRACTION_GROWTH)
EDGES_PER_FACE, SAMPLE_STEP = float(control_kernels.EDGES_PER_FACE), int(control_kernels.SAMPLE_STEP)
LIVE_FRACTION = float(control_kernels.LIVE_FRACTION)
# Meshes of at least so many faces are worked on by all CPU threads throughout; below it a thread takes longer to start
# than most kernels of a pass run.
SHARED_FACES = 60_000
# Faces that are worth a thread when gaps are closed: a step of a few nanoseconds each.
COMPACTED_FACES = 30_000


class Orderer(Ordering):
    """Goes from pass to pass on the host.

    Args:
        steps: what passes are made of.
        compacts: close the gaps that dead faces leave. That renumbers half-edges, so it decides how ties are broken;
            the loop on a device does not.
    """

    def __init__(self, steps: PassSteps, compacts: bool = True) -> None:
        super().__init__(steps)
        self._compacts = compacts
        self.pass_index, self._sample_step = 0, 0
        if not compacts:
            return
        state, device, face_count = self.state, self.device, self.face_slots
        self._live_rank = new_arrays.empty(face_count, dtype=wp.int32, device=device)
        self._spare_corner_vertex = new_arrays.like(state.corner_vertex)
        self._spare_edge_cost = new_arrays.like(state.edge_cost)
        self._spare_seam = new_arrays.like(state.seam)
        self._spare_wedge = new_arrays.like(state.wedges.corner_wedge)
        self._spare_area = new_arrays.like(state.deformation.face_area)
        self._spare_steps = new_arrays.like(state.deformation.steps)

    def run(
        self,
        target_faces: int,
        progress: Callable[[int], None] | None = None,
        recorder: NodeRecorder | None = None,
        components: Components | None = None,
    ) -> str:
        """See :class:`Ordering`."""
        self.begin(components)
        candidate_fraction = CANDIDATE_FRACTION
        while self.live_faces > target_faces:
            candidate_count, collapsed = self._run_pass(target_faces, candidate_fraction)
            if recorder and collapsed:
                end = int(self.log.count.numpy()[0])
                recorder.record(self.state, self.frames, self.log, end - collapsed, end)
            stuck = candidate_count == 0 and candidate_fraction >= 1.0
            if components:
                # Any may be pruned where no edge is left.
                cost_threshold = np.inf if stuck else float(self.steps.cost_threshold.numpy()[0])
                if self.drop_components(components, target_faces, cost_threshold):
                    continue
            if stuck:
                return self.stop_reason()
            # No legal collapse under the threshold: look further, at all edges, until every one has been refused.
            candidate_fraction = CANDIDATE_FRACTION if collapsed else min(1.0, FRACTION_GROWTH * candidate_fraction)
            if progress:
                progress(self.live_faces)
        return "target"

    def _run_pass(self, target_faces: int, candidate_fraction: float) -> tuple[int, int]:
        """One pass; the numbers of candidates and of collapses made."""
        self.pass_index += 1
        self.steps.pass_number.fill_(self.pass_index)
        remaining = self.live_faces - target_faces
        begin = int(self.log.count.numpy()[0])
        launches = self.steps.launches(self.steps.threads if self._is_shared(remaining, candidate_fraction) else 1)
        candidate_count = self._collect_candidates(launches, candidate_fraction)
        # A candidate removes two faces at most: only a pass that could overshoot has to count what it selects.
        if 2 * candidate_count <= remaining:
            for i in range(ROUNDS):
                launches.choose[i % 2].run()
                launches.commit[i % 2].run()
        else:
            launches = self.steps.launches(1)
            candidate_count = self._collect_candidates(launches, candidate_fraction)
            self._run_counted_rounds(launches, remaining)
        end = int(self.log.count.numpy()[0])
        if end > begin:
            self.live_faces -= int(self.log.faces_removed[begin:end].numpy().sum())
            compacted = self._compact()
            overfull = int(self.state.adjacency.used.numpy()[0]) > len(self.state.adjacency.corner)
            (launches.build_adjacency if compacted or overfull else launches.update_adjacency).run()
            launches.renew.run()
        return candidate_count, end - begin

    def _is_shared(self, remaining: int, candidate_fraction: float) -> bool:
        """Whether all threads work on the pass: on large meshes, but where it may end at the target."""
        return self.live_faces >= SHARED_FACES and remaining > 2 * self._wanted_count(candidate_fraction)

    def _wanted_count(self, candidate_fraction: float) -> int:
        """Edges that a pass looks at. The target has no part in it, so that all targets share one order."""
        return max(int(control_kernels.MIN_CANDIDATES), int(candidate_fraction * EDGES_PER_FACE * self.live_faces))

    def _collect_candidates(self, launches: PassLaunches, candidate_fraction: float) -> int:
        """Fill the list of candidates with the cheapest edges; their number."""
        self.steps.wanted.fill_(self._wanted_count(candidate_fraction))
        # After a pass without a collapse every edge counts: the few not suspended may be missing from a sample.
        corner_count = 3 * (self.face_slots if self._compacts else self.live_faces)
        sampled = candidate_fraction == CANDIDATE_FRACTION and corner_count >= SAMPLE_STEP * int(
            control_kernels.MIN_SAMPLE
        )
        step = SAMPLE_STEP if sampled else 1
        if step != self._sample_step:
            self.steps.sample_step.fill_(step)
            self._sample_step = step
        launches.collect.run()
        return int(launches.candidates[0].count.numpy().sum())

    def _run_counted_rounds(self, launches: PassLaunches, remaining: int) -> None:
        """Rounds of one part that stop when ``remaining`` faces are gone."""
        for i in range(ROUNDS):
            launches.choose[i % 2].run()
            remaining -= self._trim_selected(launches, remaining)
            launches.commit[i % 2].run()
            if remaining <= 0:
                return

    def _trim_selected(self, launches: PassLaunches, remaining: int) -> int:
        """Leave out the costliest collapses beyond the ``remaining`` faces to remove; the faces the others remove."""
        count = int(launches.selected.count.numpy()[0])
        faces = self.steps.faces_removed[:count].numpy().copy()
        total = int(faces.sum())
        if total <= remaining:
            return total
        # The order of the log, so that what is left is a beginning of it.
        key = new_arrays.empty(count, dtype=wp.int64, device=self.device)
        inputs = [self.state, launches.selected.half_edge]
        launch(control_kernels.list_log_keys, count, inputs, [key], device=self.device)
        order = np.argsort(key.numpy(), kind="stable")
        removed_before = np.cumsum(faces[order]) - faces[order]
        faces[order[removed_before >= remaining]] = 0
        self.steps.faces_removed[:count].assign(faces)
        launches.legal.fill_(int(np.count_nonzero(faces)))
        return int(faces.sum())

    def _compact(self) -> bool:
        """Close the gaps that dead faces leave, once they are many; whether that was so. It renumbers the corners."""
        if not self._compacts or self.live_faces >= LIVE_FRACTION * self.face_slots:
            return False
        state = self.state
        rank = self._live_rank[: self.face_slots]
        corner_vertex = corners_of(state.corner_vertex)
        self._launch_over_faces(collapse_kernels.mark_live_faces, [corner_vertex], [rows_of(rank)])
        wp.utils.array_scan(rank, rank, inclusive=True)
        self._launch_over_faces(
            collapse_kernels.move_live_faces,
            [corner_vertex, corners_of(state.edge_cost), corners_of(state.seam), rows_of(rank)],
            [self._spare_corner_vertex, self._spare_edge_cost, self._spare_seam],
        )
        if state.wedges.channel_count > 0:
            inputs = [state.corner_vertex, state.wedges.corner_wedge, rank]
            launch(
                attribute_kernels.move_corner_wedges, self.face_slots, inputs, [self._spare_wedge], device=self.device
            )
            wp.copy(state.wedges.corner_wedge, self._spare_wedge, count=3 * self.live_faces)
        if self.model.deformation_weight > 0:
            self._move_deformation(rank)
        self.face_slots = self.live_faces
        state.face_count.fill_(self.face_slots)
        # Copied back, not swapped: the recorded launches hold these arrays.
        half_edge_count = 3 * self.face_slots
        wp.copy(state.corner_vertex, self._spare_corner_vertex, count=half_edge_count)
        wp.copy(state.edge_cost, self._spare_edge_cost, count=half_edge_count)
        wp.copy(state.seam, self._spare_seam, count=half_edge_count)
        return True

    def _launch_over_faces(self, kernel: wp.Kernel, inputs: list[Any], outputs: list[Any], *rest: int) -> None:
        launch_in_parts(
            kernel, (self.face_slots, *rest), inputs, outputs, device=self.device, min_items=COMPACTED_FACES
        )

    def _move_deformation(self, rank: wp.array) -> None:
        """Close the gaps in what the deformation term has measured; ``rank`` as for the faces, which still stand."""
        measured = self.state.deformation
        chunk_count = measured.steps.shape[1]
        rows = [corners_of(self.state.corner_vertex), rows_of(measured.face_area), corners_of(measured.steps)]
        self._launch_over_faces(
            deformation_kernels.move_deformation,
            [*rows, rows_of(rank)],
            [self._spare_area, self._spare_steps],
            chunk_count,
        )
        wp.copy(measured.face_area, self._spare_area, count=self.live_faces * chunk_count)
        wp.copy(measured.steps, self._spare_steps, count=3 * self.live_faces * chunk_count)
