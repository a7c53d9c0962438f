"""The steps of a round with many threads a collapse, and what they hand each other."""

from __future__ import annotations

import warp as wp

from warpqem.decimation.pass_steps import PassSteps
from warpqem.decimation.recorded_launches import LaunchGroup, part_work, record_shared
from warpqem.kernels import shared_collapse as kernels
from warpqem.kernels.lanes import width_of
from warpqem.kernels.mesh_state import INFINITE_BITS
from warpqem.kernels.shared_collapse import CheckNotes
from warpqem.kernels.work import EdgeList
from warpqem.runtime import new_arrays
from warpqem.runtime.launches import Recorder

__all__ = ["SharedSteps"]


class SharedSteps:
    """Places, checks and commits what a round has selected; see :mod:`warpqem.kernels.shared_collapse`.

    Args:
        steps: what else passes are made of.
    """

    def __init__(self, steps: PassSteps) -> None:
        self._steps, self._width = steps, width_of(steps.frames.position)
        self._work = part_work(0, 1, steps.device)
        notes = self._notes = CheckNotes()
        notes.refused = steps.integers(len(steps.faces_removed))
        vertex_count, corner_count = len(steps.state.vertex_flags), len(steps.state.corner_vertex)
        notes.member_gap = new_arrays.empty(vertex_count, dtype=wp.float32, device=steps.device)
        notes.face_area = new_arrays.empty((2, corner_count), dtype=wp.float32, device=steps.device)
        notes.face_distance = new_arrays.full((2, corner_count), INFINITE_BITS, dtype=wp.int32, device=steps.device)

    def checking(self, selected: EdgeList) -> list[LaunchGroup]:
        """The faces that each selected collapse removes, and where it puts its vertex."""
        steps, width, work = self._steps, self._width, self._work
        state, frames, model = steps.state, steps.frames, steps.model

        def check(recorder: Recorder, _: int) -> None:
            record_shared(recorder, kernels.measure_anchors[width], [frames, state, selected], work, [steps.target])
            terms = [state, model, selected, steps.target]
            record_shared(recorder, kernels.sum_anchor_terms[width], terms, work, [steps.anchor])
            placed = [frames, state, model, selected, steps.anchor]
            record_shared(recorder, kernels.place_blocks[width], placed, work, [steps.target])
            checked = [frames, state, model, selected, steps.target, steps.flip_tolerance, steps.log.round_count]
            record_shared(recorder, kernels.check_slots[width], checked, work, [self._notes])
            settled = [state, self._notes, frames, model, selected, steps.log.round_count]
            record_shared(recorder, kernels.settle_collapses[width], settled, work, [steps.faces_removed, steps.error])

        return [LaunchGroup(check)]

    def committing(self, selected: EdgeList, faces_removed: wp.array) -> list[LaunchGroup]:
        """Apply the collapses that remove faces."""
        steps, width, work = self._steps, self._width, self._work
        state, frames = steps.state, steps.frames

        def commit(recorder: Recorder, _: int) -> None:
            merged = [state, selected, faces_removed]
            record_shared(recorder, kernels.merge_blocks[width], merged, work, [frames, steps.target])
            terms = [state, frames, selected, faces_removed, steps.target, steps.anchor, steps.error, steps.pass_number]
            outputs = [steps.mask, steps.log, steps.log.count, state.adjacency.used]
            record_shared(recorder, kernels.commit_merged[width], terms, work, outputs)

        return [LaunchGroup(commit)]
