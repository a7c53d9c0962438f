"""The parallel pass as a loop on the device: the host launches it once, and looks at it when it has ended.

It makes the collapses that :class:`warpqem.decimation.passes.Orderer` makes without closing gaps: reading dead faces
costs a GPU less than waiting for the host. Two matters still stop it: components that may be pruned,
and, where a graph holds no branches, a full adjacency pool.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.decimation.collapse_nodes import NodeRecorder
from warpqem.decimation.ordering import Ordering
from warpqem.decimation.pass_steps import HISTOGRAM_BINS, ROUNDS, PassSteps
from warpqem.decimation.pruning import Components
from warpqem.decimation.recorded_launches import LaunchGroup, new_edge_list, part_work, record_shared, run_once
from warpqem.decimation.shared_steps import SharedSteps
from warpqem.kernels import pass_control as kernels
from warpqem.kernels.components import mark_remnants, measure_components
from warpqem.kernels.pass_control import COMPONENTS, FULL_POOL, RUNNING, STUCK, PassControl
from warpqem.kernels.work import EdgeList
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import Recorder, launch
from warpqem.runtime.loops import DeviceLoop
from warpqem.runtime.readback import read_together

__all__ = ["DeviceOrderer"]


@dataclass(frozen=True)
class _Report:
    """What the host sees of a loop, in the order of the device's array."""

    running: int
    status: int
    live_faces: int
    collapse_count: int


class DeviceOrderer(Ordering):
    """Goes from pass to pass on the device.

    Args:
        steps: what passes are made of. The adjacency pool has room for twice the corners: what the collapses of one
            pass take, beside those of all vertices.
    """

    def __init__(self, steps: PassSteps) -> None:
        super().__init__(steps)
        corner_count = len(self.state.corner_vertex)
        if len(self.state.adjacency.corner) < 2 * corner_count:
            raise ValueError(f"adjacency lists of {corner_count} corners need a pool of {2 * corner_count}")
        self._report = steps.integers(len(_Report.__dataclass_fields__))
        self._control = self._new_control()
        self._stops_when_full = int(not device_traits(self.device).graph_loops)
        self._collapse_count = 0
        self._recorded = 0  # collapses that a recorder has seen
        self._work = part_work(0, 1, self.device)

    def _new_control(self) -> PassControl:
        control, steps = PassControl(), self.steps
        for index, name in enumerate(_Report.__dataclass_fields__):
            setattr(control, name, self._report[index : index + 1])
        for name in ("target_faces", "removed_faces", "candidate_count", "pass_collapses", "overfull", "remnant_count"):
            setattr(control, name, steps.integers(1))
        for name in ("pass_number", "pass_begin", "wanted", "sample_step"):
            setattr(control, name, getattr(steps, name))
        control.pass_threshold = new_arrays.zeros(1, dtype=wp.float32, device=self.device)
        control.fraction = new_arrays.full(1, float(kernels.CANDIDATE_FRACTION), dtype=wp.float64, device=self.device)
        return control

    def run(
        self,
        target_faces: int,
        progress: Callable[[int], None] | None = None,
        recorder: NodeRecorder | None = None,
        components: Components | None = None,
    ) -> str:
        """See :class:`Ordering`."""
        self.begin(components)
        if self.live_faces <= target_faces:
            return "target"
        self._report.assign(np.array([1, int(RUNNING), self.live_faces, 0], dtype=np.int32))
        self._control.target_faces.fill_(target_faces)
        in_turns = progress is not None or recorder is not None
        loop = DeviceLoop(self._record_pass(components), self._report, self.device, in_turns)
        while True:
            report = self._go_on(loop, progress, recorder)
            self.live_faces, self._collapse_count = report.live_faces, report.collapse_count
            if report.status == FULL_POOL:
                run_once(self._building_adjacency(), self.device)
            elif report.status == COMPONENTS:
                assert components is not None
                self._look_at(components, target_faces, progress)
            elif report.status == STUCK:
                return self.stop_reason()
            else:
                return "target"

    def collapse_count(self) -> int:
        """See :class:`Ordering`; the device has reported it."""
        return self._collapse_count

    def _go_on(
        self, loop: DeviceLoop, progress: Callable[[int], None] | None, recorder: NodeRecorder | None
    ) -> _Report:
        """Passes until the loop ends by itself; where it ended."""
        if progress is None and recorder is None:
            loop.complete()
            along = () if self.along is None else self.along()
            numbers, *self.brought = read_together(self._report, *along)
            return _Report(*numbers.tolist())
        # A recorder reads what the last pass left, so that there must be no other under way.
        for numbers in loop.turns(0) if recorder else loop.turns():
            report = _Report(*numbers.tolist())
            if recorder and report.collapse_count > self._recorded:
                recorder.record(self.state, self.frames, self.log, self._recorded, report.collapse_count)
                self._recorded = report.collapse_count
            if progress and report.status not in (STUCK, COMPONENTS):
                progress(report.live_faces)
        return report

    def _look_at(self, components: Components, target_faces: int, progress: Callable[[int], None] | None) -> None:
        """Prune components after a pass, and close it."""
        cost_threshold = float(self._control.pass_threshold.numpy()[0])
        dropped = self.drop_components(components, target_faces, cost_threshold)
        inputs = [self.state, dropped, self._stops_when_full]
        launch(kernels.resume_passes, 1, inputs, [self._control], device=self.device)
        if progress and not dropped:
            progress(self.live_faces)

    def _record_pass(self, components: Components | None) -> Recorder:
        recorder = Recorder(self.device)
        if not self._stops_when_full:
            building = Recorder(self.device)
            _record(building, self._building_adjacency())
            recorder.branch(self._control.overfull, building)
        _record(recorder, self._pass_groups())
        if components is not None:
            self._record_remnants(recorder, components)
        inputs = [self.state, self.log, self._stops_when_full]
        recorder.launch(kernels.end_pass, 1, inputs, [self._control])
        return recorder

    def _pass_groups(self) -> list[LaunchGroup]:
        steps, control = self.steps, self._control
        lists = [new_edge_list(storage, 1) for storage in steps.lists]
        selected = lists.pop()
        histogram = new_arrays.zeros((1, HISTOGRAM_BINS), dtype=wp.int32, device=self.device)
        kept, shared = steps.integers(len(steps.faces_removed)), SharedSteps(steps)

        def begin(recorder: Recorder, _: int) -> None:
            recorder.launch(kernels.begin_pass, 1, [self.log, control.live_faces], [control, lists[0]])

        groups = [LaunchGroup(begin), *steps.collecting(lists[0], histogram, 1)]
        for index in range(ROUNDS):
            now, left = lists[index % 2], lists[1 - index % 2]

            def begin_round(
                recorder: Recorder, _: int, index: int = index, now: EdgeList = now, left: EdgeList = left
            ) -> None:
                inputs = [now, int(index == 0)]
                recorder.launch(kernels.begin_round, 1, inputs, [control, self.log, selected, left])

            def trim(recorder: Recorder, _: int) -> None:
                inputs = [self.state, selected, steps.faces_removed]
                record_shared(recorder, kernels.trim_collapses, inputs, self._work, [control, kept])

            groups += [
                LaunchGroup(begin_round),
                *steps.selecting(now, selected, 1),
                *shared.checking(selected),
                LaunchGroup(trim),
                *shared.committing(selected, kept),
                *steps.shrinking(now, left, 1),
            ]
        return [*groups, *steps.updating_adjacency(1), *steps.renewing(1)]

    def _building_adjacency(self) -> list[LaunchGroup]:
        def note(recorder: Recorder, _: int) -> None:
            recorder.launch(kernels.note_new_adjacency, 1, [], [self._control])

        return [*self.steps.adjacency.launch_groups(1), LaunchGroup(note)]

    def _record_remnants(self, recorder: Recorder, components: Components) -> None:
        """Count the components that may be pruned."""
        of_vertex = new_arrays.uploaded(components.vertex_component, dtype=wp.int32, device=self.device)
        least_loss = components.least_loss
        face_count, cheapness, is_remnant = (self.steps.integers(len(least_loss)) for _ in range(3))
        for cleared in (face_count, cheapness, self._control.remnant_count):
            recorder.zero(cleared)
        record_shared(recorder, measure_components, [self.state, of_vertex], self._work, [face_count, cheapness])
        recorder.launch(kernels.note_threshold, 1, [self.steps.cost_threshold], [self._control])
        inputs = [face_count, cheapness, least_loss, self._control.pass_threshold]
        record_shared(recorder, mark_remnants, inputs, self._work, [is_remnant, self._control.remnant_count])


def _record(recorder: Recorder, groups: Sequence[LaunchGroup]) -> None:
    for group in groups:
        for part in range(group.part_count):
            group.record(recorder, part)
