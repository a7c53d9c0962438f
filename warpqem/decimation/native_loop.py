"""The parallel pass on small meshes of a CPU, where the host takes longer between kernels than they run.

It makes the collapses of :class:`warpqem.decimation.passes.Orderer`, from the same kernels: all passes are one call.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import warp as wp

from warpqem.decimation.collapse_nodes import NodeRecorder
from warpqem.decimation.pass_steps import HISTOGRAM_BINS, ROUNDS
from warpqem.decimation.passes import SHARED_FACES, Orderer
from warpqem.decimation.pruning import Components
from warpqem.decimation.recorded_launches import LaunchGroup, new_edge_list
from warpqem.kernels import collapse as collapse_kernels
from warpqem.kernels import pass_control as kernels
from warpqem.kernels.pass_control import PassControl, Upkeep
from warpqem.kernels.work import EdgeList
from warpqem.runtime import new_arrays
from warpqem.runtime.native_programs import NativeRecorder

__all__ = ["SmallOrderer"]

# Faces, times blocks of key frames, up to which a mesh is small: all of its passes take half a second at most, a second
# beside other work, so nobody waits for progress or to interrupt it, and one thread does them as it is.
SMALL_FACES = 2**18


class SmallOrderer(Orderer):
    """Goes from pass to pass without the host, where nobody has to look at what happens in between."""

    def run(
        self,
        target_faces: int,
        progress: Callable[[int], None] | None = None,
        recorder: NodeRecorder | None = None,
        components: Components | None = None,
    ) -> str:
        """See :class:`Ordering`. Progress is told at the end."""
        is_small = self.face_slots < SHARED_FACES and self.face_slots * self.frames.position.shape[1] <= SMALL_FACES
        has_more = self.state.wedges.channel_count > 0 or self.model.deformation_weight > 0
        if not is_small or has_more or recorder is not None or components is not None:
            return super().run(target_faces, progress, recorder, components)
        self.begin(None)
        if self.live_faces <= target_faces:
            return "target"
        control = self._new_control(target_faces)
        self._loop(control).finish_loop(control.running)()
        self.live_faces, self.face_slots = (int(n.numpy()[0]) for n in (control.live_faces, self.state.face_count))
        if progress:
            progress(self.live_faces)
        return "target" if int(control.status.numpy()[0]) == kernels.TARGET else self.stop_reason()

    def _new_control(self, target_faces: int) -> PassControl:
        control, steps = PassControl(), self.steps
        zero = ("status", "removed_faces", "candidate_count", "pass_collapses", "overfull", "remnant_count")
        for name in (*zero, "collapse_count"):
            setattr(control, name, steps.integers(1))
        values = {"running": 1, "live_faces": self.live_faces, "target_faces": target_faces}
        for name, value in values.items():
            setattr(control, name, new_arrays.full(1, value, dtype=wp.int32, device=self.device))
        for name in ("pass_number", "pass_begin", "wanted", "sample_step"):
            setattr(control, name, getattr(steps, name))
        control.pass_threshold = new_arrays.zeros(1, dtype=wp.float32, device=self.device)
        control.fraction = new_arrays.full(1, float(kernels.CANDIDATE_FRACTION), dtype=wp.float64, device=self.device)
        return control

    def _loop(self, control: PassControl) -> NativeRecorder:
        """A pass, which says in ``control`` whether there is another one."""
        steps = self.steps
        lists = [new_edge_list(storage, 1) for storage in steps.lists]
        selected = lists.pop()
        histogram = new_arrays.zeros((1, HISTOGRAM_BINS), dtype=wp.int32, device=self.device)
        loop = NativeRecorder()
        loop.launch(kernels.begin_pass, 1, [self.log, self.state.face_count], [control, lists[0]])
        loop.append(_recorded(steps.collecting(lists[0], histogram, 1)))
        loop.launch(kernels.note_candidates, 1, [lists[0]], [control])
        slots = [steps.integers(1) for _ in range(4)]
        kept = steps.integers(len(steps.faces_removed))
        rounds = [self._round(control, lists[i], lists[1 - i], selected, slots, kept) for i in range(2)]
        for index in range(ROUNDS):
            loop.append(rounds[index % 2])
        self._record_upkeep(loop, control)
        loop.launch(kernels.end_pass, 1, [self.state, self.log, 0], [control])
        return loop

    def _round(
        self,
        control: PassControl,
        now: EdgeList,
        left: EdgeList,
        selected: EdgeList,
        slots: Sequence[wp.array],
        kept: wp.array,
    ) -> NativeRecorder:
        """Select, check and apply collapses among candidates ``now``; those that it leaves free are ``left``."""
        steps = self.steps
        legal, space, slot, pool_slot = slots
        recorder = NativeRecorder()
        recorder.zero(selected.count)
        recorder.zero(left.count)
        groups = [*steps.selecting(now, selected, 1), *steps.checking(selected, legal, space, 1)]
        recorder.append(_recorded(groups))
        inputs = [self.state, selected, steps.faces_removed]
        recorder.launch(kernels.trim_in_order, 1, inputs, [control, kept, legal])
        outputs = [legal, space, self.log, slot, self.state.adjacency.used, pool_slot]
        recorder.launch(collapse_kernels.open_log, 1, [], outputs)
        groups = [*steps.committing(selected, kept, slot, pool_slot, 1), *steps.shrinking(now, left, 1)]
        recorder.append(_recorded(groups))
        return recorder

    def _record_upkeep(self, loop: NativeRecorder, control: PassControl) -> None:
        """Close gaps, and bring the adjacency and costs up to date, where the pass has collapsed edges."""
        steps, upkeep = self.steps, Upkeep()
        for name in ("any", "compacts", "builds", "updates"):
            setattr(upkeep, name, steps.integers(1))
        loop.launch(kernels.find_upkeep, 1, [self.state, self.log, control], [upkeep])
        loop.branch(upkeep.compacts, self._compaction(control))
        loop.branch(upkeep.builds, _recorded(steps.adjacency.launch_groups(1)))
        loop.branch(upkeep.updates, _recorded(steps.updating_adjacency(1)))
        loop.branch(upkeep.any, _recorded(steps.renewing(1, 1)))

    def _compaction(self, control: PassControl) -> NativeRecorder:
        """Close the gaps that dead faces leave; see :meth:`Orderer._compact`."""
        state, rank, recorder = self.state, self._live_rank, NativeRecorder()
        threads, counted = self.face_slots, state.face_count
        recorder.launch(collapse_kernels.mark_live_faces, threads, [state.corner_vertex], [rank], counted=counted)
        recorder.scan(rank, rank, counted=counted, inclusive=True)
        moved = [state.corner_vertex, state.edge_cost, state.seam]
        spare = [self._spare_corner_vertex, self._spare_edge_cost, self._spare_seam]
        recorder.launch(collapse_kernels.move_live_faces, threads, [*moved, rank], spare, counted=counted)
        recorder.copy(counted, control.live_faces)
        for target, source in zip(moved, spare, strict=True):
            recorder.copy(target, source, count=3, counted=counted)
        return recorder


def _recorded(groups: Sequence[LaunchGroup]) -> NativeRecorder:
    recorder = NativeRecorder()
    for group in groups:
        group.record(recorder, 0)
    return recorder
