"""The parallel pass: cap, candidates, rounds of claim and commit, until the target is met.

A pass reads aloud as: price what moved, find the cap, collect the candidates under it, then for a few rounds: claim,
select, place, judge, commit; at last bring the stars up to date. Everything but the counts stays on the device.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from warpqem.kernels import attribute as attribute_kernels
from warpqem.kernels import collapse as collapse_kernels
from warpqem.kernels import edge_cost as cost_kernels
from warpqem.kernels import forgetting as forgetting_kernels
from warpqem.kernels import independent_set as set_kernels
from warpqem.kernels import legality as legality_kernels
from warpqem.kernels.lanes import width_of
from warpqem.kernels.mesh_state import AnyKeyFrames, CollapseLog, CostModel, MeshState
from warpqem.kernels.topology import LOCKED
from warpqem.kernels.work import EdgeList, Work
from warpqem.order.drops import ComponentDrop, Components
from warpqem.order.nodes import NodeRecorder
from warpqem.order.quadrics import CONSTRAINT_WEIGHT
from warpqem.order.stars import Stars
from warpqem.order.steps import Phase, Step, new_edge_list, part_work
from warpqem.parallel import launch_parts, thread_count

__all__ = ["Orderer"]

# Part of the edges that one pass may touch. More is faster and further from the serial greedy order.
CAP_FRACTION = 0.05
# A pass looks at this many edges at least, or on small meshes each would do one collapse.
LEAST_CANDIDATES = 32
# Rounds of claims a pass; each finds winners among the candidates that the earlier ones left free.
ROUNDS = 3
# Faces are compacted when fewer than this part of them is alive.
LIVE_FRACTION = 0.7
# A face may turn over in this part of the key frames (crumpling motion); 1 of 16.
FLIP_FRACTION = 0.07
HISTOGRAM_BINS = 4096
# The cap is read off every so many half-edges (a step without the factor 3 sees all corners alike), but off all of them
# where the sample would hold fewer than so many: the cap need not be exact, only the same on every run.
SAMPLE_STEP = 7
LEAST_SAMPLE = 2048
# Meshes of at least so many faces are worked on by all CPU threads throughout; below it a thread takes longer to start
# than most kernels of a pass run.
SHARED_FACES = 60_000
# Faces that are worth a thread when gaps are closed: a step of a few nanoseconds each.
COMPACTED_FACES = 30_000


@dataclass(frozen=True)
class _Gear:
    """The steps of a pass, recorded for a number of parts. Rounds take turns with two lists of candidates."""

    collect_sampled: Step
    collect_all: Step
    choose: tuple[Step, Step]
    commit: tuple[Step, Step]
    build_stars: Step
    keep_stars: Step
    renew: Step
    candidates: tuple[EdgeList, EdgeList]
    winners: EdgeList
    legal: wp.array


class Orderer:
    """Collapses the edges of one mesh state, pass by pass."""

    def __init__(
        self,
        state: MeshState,
        frames: AnyKeyFrames,
        stars: Stars,
        model: CostModel,
        key_count: int,
        device: str,
        memory: float = 1.0,
    ) -> None:
        """``memory`` is what the planes of the input count against those of the present faces; 1: they are all."""
        self.state, self.frames, self.stars, self.model, self.device = state, frames, stars, model, device
        self._width, self.memory = width_of(frames.position), memory
        face_count = len(state.corner_vertex) // 3
        vertex_count = len(state.vertex_flags)
        self.face_slots = face_count  # faces in the arrays, dead ones included
        self.live_faces = face_count
        self.pass_index = 0
        self.drops: list[ComponentDrop] = []
        self.flip_tolerance = int(FLIP_FRACTION * key_count)
        self.threads = thread_count(device)
        self.log = self._new_log(vertex_count)
        self._pass_number, self._pass_begin, self._wanted = (self._integers(1) for _ in range(3))
        self._cap = wp.zeros(1, dtype=wp.float32, device=device)
        self._claim = wp.full(vertex_count, set_kernels.UNCLAIMED, dtype=wp.int64, device=device)
        self._mask, self._dropped = self._integers(vertex_count), self._integers(vertex_count)
        # Winners share no vertex, so there are V / 2 at most; an edge stands at one of its two half-edges.
        most_winners = vertex_count // 2 + 1
        self._lists = [wp.empty(3 * face_count, dtype=wp.int32, device=device) for _ in range(3)]
        self._faces_removed = self._integers(most_winners)
        shape = (most_winners, frames.position.shape[1])
        self._target = wp.empty(shape, dtype=frames.position.dtype, device=device)
        self._anchor = wp.empty(most_winners, dtype=wp.float32, device=device)
        self._live_rank = wp.empty(face_count, dtype=wp.int32, device=device)
        self._spare_corner_vertex = wp.empty_like(state.corner_vertex)
        self._spare_edge_cost = wp.empty_like(state.edge_cost)
        self._spare_seam = wp.empty_like(state.seam)
        self._spare_wedge = wp.empty_like(state.wedges.corner_wedge)
        self._price_all = Step([Phase(self._launch_pricing, self.threads)], device)
        self._gears: dict[int, _Gear] = {}

    def _integers(self, count: int) -> wp.array:
        return wp.zeros(count, dtype=wp.int32, device=self.device)

    def _new_log(self, capacity: int) -> CollapseLog:
        log = CollapseLog()
        log.count, log.round_count = self._integers(1), self._integers(1)
        for name in ("kept", "removed", "left_wing", "right_wing", "faces_removed", "round_index"):
            setattr(log, name, wp.empty(capacity, dtype=wp.int32, device=self.device))
        for name in ("cost", "error"):
            setattr(log, name, wp.empty(capacity, dtype=wp.float32, device=self.device))
        return log

    def _launch(self, kernel: wp.Kernel, inputs: list, work: Work, outputs: Sequence = ()) -> None:
        wp.launch(kernel, dim=work.lanes, inputs=[*inputs, work], outputs=list(outputs), device=self.device)

    def _launch_pricing(self, part: int) -> None:
        work = part_work(part, self.threads, self.device)
        self._launch(cost_kernels.price_all_edges[self._width], [self.state, self.frames, self.model], work)

    def _gear(self, part_count: int) -> _Gear:
        """The steps for so many parts, recorded when they are first asked for."""
        if part_count not in self._gears:
            candidates = tuple(new_edge_list(storage, part_count) for storage in self._lists[:2])
            winners = new_edge_list(self._lists[2], part_count)
            legal, space, slot, pool_slot = (self._integers(part_count) for _ in range(4))
            orders = [(candidates[0], candidates[1]), (candidates[1], candidates[0])]
            choose = [self._choosing(now, winners, legal, space, part_count) for now, _ in orders]
            commit = [
                self._committing(*order, winners, (legal, space, slot, pool_slot), part_count) for order in orders
            ]
            histogram = wp.zeros((part_count, HISTOGRAM_BINS), dtype=wp.int32, device=self.device)
            self._gears[part_count] = _Gear(
                collect_sampled=self._step(self._collecting(candidates[0], SAMPLE_STEP, histogram, part_count)),
                collect_all=self._step(self._collecting(candidates[0], 1, histogram, part_count)),
                choose=(self._step(choose[0]), self._step(choose[1])),
                commit=(self._step(commit[0]), self._step(commit[1])),
                build_stars=self._step(self.stars.phases(part_count)),
                keep_stars=self._step(self._keeping_stars(part_count)),
                renew=self._step(self._renewing(part_count)),
                candidates=candidates,
                winners=winners,
                legal=legal,
            )
        return self._gears[part_count]

    def _step(self, phases: Sequence[Phase]) -> Step:
        return Step(phases, self.device)

    def _collecting(self, candidates: EdgeList, sample_step: int, histogram: wp.array, part_count: int) -> list[Phase]:
        """Fill the list of candidates with the cheapest edges; ``histogram`` is zero between passes."""
        state, device = self.state, self.device

        def count(part: int) -> None:
            work = part_work(part, part_count, device)
            self._launch(set_kernels.count_costs, [state, sample_step], work, [histogram])

        def find_cap(_: int) -> None:
            wp.copy(self._pass_begin, self.log.count)
            wp.launch(
                set_kernels.find_cap,
                dim=1,
                inputs=[self._wanted, sample_step],
                outputs=[histogram, self._cap],
                device=device,
            )
            candidates.count.zero_()

        def collect(part: int) -> None:
            work = part_work(part, part_count, device)
            self._launch(set_kernels.collect_candidates, [state, self._cap], work, [candidates])

        return [Phase(count, part_count), Phase(find_cap), Phase(collect, part_count)]

    def _choosing(
        self, candidates: EdgeList, winners: EdgeList, legal: wp.array, space: wp.array, part_count: int
    ) -> list[Phase]:
        """Claim, select, place and judge."""
        state, frames = self.state, self.frames

        def claim(part: int) -> None:
            if part == 0:
                winners.count.zero_()
            work = part_work(part, part_count, self.device)
            self._launch(set_kernels.claim_vertices, [state, candidates], work, [self._claim])

        def select(part: int) -> None:
            work = part_work(part, part_count, self.device)
            self._launch(set_kernels.select_winners, [state, candidates, self._claim], work, [winners])

        def judge(part: int) -> None:
            work = part_work(part, part_count, self.device)
            self._launch(set_kernels.withdraw_claims, [state, candidates], work, [self._claim])
            targets = [self._target, self._anchor]
            self._launch(
                legality_kernels.place_winners[self._width], [state, frames, self.model, winners], work, targets
            )
            judged = [state, frames, self.model, winners, self._target, self.flip_tolerance]
            self._launch(legality_kernels.judge_winners[self._width], judged, work, [self._faces_removed, legal, space])

        return [Phase(claim, part_count), Phase(select, part_count), Phase(judge, part_count)]

    def _committing(
        self,
        candidates: EdgeList,
        candidates_left: EdgeList,
        winners: EdgeList,
        reserve: Sequence[wp.array],
        part_count: int,
    ) -> list[Phase]:
        """Collapse the legal winners, and keep the candidates that they leave free.

        ``reserve`` holds, for each part: legal winners, entries of the pool for their stars, the first slots of both.
        """
        state, frames = self.state, self.frames
        legal, space, slot, pool_slot = reserve

        def open_log(_: int) -> None:
            outputs = [legal, space, self.log, slot, state.stars.used, pool_slot]
            wp.launch(collapse_kernels.open_log, dim=1, inputs=[], outputs=outputs, device=self.device)
            candidates_left.count.zero_()

        def commit(part: int) -> None:
            work = part_work(part, part_count, self.device)
            inputs = [state, frames, winners, self._faces_removed, self._target, self._anchor, self._pass_number]
            self._launch(
                collapse_kernels.commit_winners[self._width], inputs, work, [self._mask, self.log, slot, pool_slot]
            )

        def shrink(part: int) -> None:
            work = part_work(part, part_count, self.device)
            inputs = [state, self._mask, self._pass_number, candidates]
            self._launch(set_kernels.shrink_candidates, inputs, work, [candidates_left])

        return [Phase(open_log), Phase(commit, part_count), Phase(shrink, part_count)]

    def _keeping_stars(self, part_count: int) -> list[Phase]:
        """Bring the stars of the wings up to date; those of the vertices that moved are since the commit."""

        def drop(part: int) -> None:
            work = part_work(part, part_count, self.device)
            inputs = [self.state, self.log, self._pass_begin, self._pass_number]
            self._launch(collapse_kernels.drop_dead_corners, inputs, work, [self._dropped])

        return [Phase(drop, part_count)]

    def _renewing(self, part_count: int) -> list[Phase]:
        """Price what moved, wake what lies around it. Prices are worth all threads on any mesh."""
        state = self.state

        def reprice(part: int) -> None:
            work = part_work(part, self.threads, self.device)
            inputs = [state, self.frames, self.model, self.log, self._pass_begin]
            self._launch(cost_kernels.reprice_moved_stars[self._width], inputs, work)

        def wake(part: int) -> None:
            work = part_work(part, part_count, self.device)
            self._launch(cost_kernels.wake_neighbourhoods, [state, self._mask, self._pass_number], work)

        if self.memory < 1.0:
            return self._forgetting()
        return [Phase(reprice, self.threads), Phase(wake, part_count)]

    def _forgetting(self) -> list[Phase]:
        """Blend the present planes into the quadrics around what moved, and price all edges there."""
        model = forgetting_kernels.Forgetting()
        model.memory = self.memory
        model.border_weight, model.seam_weight = CONSTRAINT_WEIGHT[1], CONSTRAINT_WEIGHT[2]
        around = [self._mask, self._pass_number]

        def forget(part: int) -> None:
            work = part_work(part, self.threads, self.device)
            self._launch(forgetting_kernels.forget_planes[self._width], [self.state, self.frames, model, *around], work)

        def reprice(part: int) -> None:
            work = part_work(part, self.threads, self.device)
            inputs = [self.state, self.frames, self.model, *around]
            self._launch(forgetting_kernels.reprice_neighbourhoods[self._width], inputs, work)

        return [Phase(forget, self.threads), Phase(reprice, self.threads)]

    def run(
        self,
        target_faces: int,
        progress: Callable[[int], None] | None = None,
        recorder: NodeRecorder | None = None,
        components: Components | None = None,
    ) -> str:
        """Collapse until the target is met; small ones of ``components``, if given, may vanish.

        ``progress`` is called with the live face count after each pass, ``recorder`` is shown what each pass merged.

        Returns:
            "target"; "max_error" when every edge left would exceed the model's error limit or is illegal, and at least
            one is held back by the limit alone; "no legal collapse" otherwise.
        """
        self._price_all.run()
        cap_fraction = CAP_FRACTION
        while self.live_faces > target_faces:
            candidate_count, collapsed = self._run_pass(target_faces, cap_fraction)
            if recorder and collapsed:
                end = int(self.log.count.numpy()[0])
                recorder.record(self.state, self.frames, self.log, end - collapsed, end)
            stuck = candidate_count == 0 and cap_fraction >= 1.0
            if components and self._drop_components(components, target_faces, stuck):
                continue
            if stuck:
                return "max_error" if self._is_limited() else "no legal collapse"
            # No legal winner under the cap: look further, at all edges, until every one has been refused.
            cap_fraction = CAP_FRACTION if collapsed else min(1.0, 4.0 * cap_fraction)
            if progress:
                progress(self.live_faces)
        return "target"

    def _drop_components(self, components: Components, target_faces: int, stuck: bool) -> bool:
        """Let small components vanish that cost less than the last pass's cap; any, where no edge is left."""
        cap = np.inf if stuck else float(self._cap.numpy()[0])
        collapse_count = int(self.log.count.numpy()[0])
        excess = self.live_faces - target_faces
        drops = components.drop(self.frames, cap, excess, collapse_count, self.face_slots)
        self.live_faces -= sum(drop.face_count for drop in drops)
        self.drops += drops
        return len(drops) > 0

    def _is_limited(self) -> bool:
        """Whether the error limit holds back an edge: without it more edges have a price than lie asleep.

        Lifts the limit and prices all edges anew, so nothing may collapse after it.
        """
        half_edge_count = 3 * self.face_slots
        asleep = np.isfinite(self.state.edge_cost.numpy()[:half_edge_count]).sum()
        self.model.error_limit = np.inf
        self._step([Phase(self._launch_pricing, self.threads)]).run()
        return bool(np.isfinite(self.state.edge_cost.numpy()[:half_edge_count]).sum() > asleep)

    def _run_pass(self, target_faces: int, cap_fraction: float) -> tuple[int, int]:
        """One pass; the numbers of candidates and of collapses made."""
        self.pass_index += 1
        self._pass_number.fill_(self.pass_index)
        remaining = self.live_faces - target_faces
        begin = int(self.log.count.numpy()[0])
        gear = self._gear(self.threads if self._is_shared(remaining, cap_fraction) else 1)
        candidate_count = self._collect_candidates(gear, cap_fraction)
        # A candidate removes two faces at most: only a pass that could overshoot has to count its winners.
        if 2 * candidate_count <= remaining:
            for i in range(ROUNDS):
                gear.choose[i % 2].run()
                gear.commit[i % 2].run()
        else:
            gear = self._gear(1)
            candidate_count = self._collect_candidates(gear, cap_fraction)
            self._run_counted_rounds(gear, remaining)
        end = int(self.log.count.numpy()[0])
        if end > begin:
            self.live_faces -= int(self.log.faces_removed.numpy()[begin:end].sum())
            compacted = self._compact()
            overfull = int(self.state.stars.used.numpy()[0]) > len(self.state.stars.corner)
            (gear.build_stars if compacted or overfull else gear.keep_stars).run()
            gear.renew.run()
        return candidate_count, end - begin

    def _is_shared(self, remaining: int, cap_fraction: float) -> bool:
        """Whether all threads work on the pass: on large meshes, but where it may end at the target."""
        return self.live_faces >= SHARED_FACES and remaining > 2 * self._wanted_count(cap_fraction)

    def _wanted_count(self, cap_fraction: float) -> int:
        """Edges that a pass looks at. The target has no part in it, so that all targets share one order."""
        return max(LEAST_CANDIDATES, int(cap_fraction * 1.5 * self.live_faces))

    def _collect_candidates(self, gear: _Gear, cap_fraction: float) -> int:
        """Fill the list of candidates with the cheapest edges; their number."""
        self._wanted.fill_(self._wanted_count(cap_fraction))
        # After a pass without a winner every edge counts: the few that are awake may be missing from a sample.
        sampled = cap_fraction == CAP_FRACTION and 3 * self.face_slots >= SAMPLE_STEP * LEAST_SAMPLE
        (gear.collect_sampled if sampled else gear.collect_all).run()
        return int(gear.candidates[0].count.numpy().sum())

    def _run_counted_rounds(self, gear: _Gear, remaining: int) -> None:
        """Rounds of one part that stop when ``remaining`` faces are gone."""
        for i in range(ROUNDS):
            gear.choose[i % 2].run()
            remaining -= self._trim_winners(gear, remaining)
            gear.commit[i % 2].run()
            if remaining <= 0:
                return

    def _trim_winners(self, gear: _Gear, remaining: int) -> int:
        """Drop the dearest winners beyond the ``remaining`` faces to remove; the faces that the others remove."""
        count = int(gear.winners.count.numpy()[0])
        faces = self._faces_removed.numpy()[:count]
        half_edge = gear.winners.half_edge.numpy()[:count]
        # The order of the log, so that what is left is a beginning of it.
        order = np.lexsort((self._removed_vertices(half_edge), self.state.edge_cost.numpy()[half_edge]))
        removed_before = np.cumsum(faces[order]) - faces[order]
        faces[order[removed_before >= remaining]] = 0
        if not self._faces_removed.device.is_cpu:
            self._faces_removed[:count].assign(faces)
        gear.legal.fill_(int(np.count_nonzero(faces)))
        return int(faces.sum())

    def _removed_vertices(self, half_edge: np.ndarray) -> np.ndarray:
        """The end that each collapse removes, as the commit chooses it."""
        corner_vertex, flags = self.state.corner_vertex.numpy(), self.state.vertex_flags.numpy()
        ends = corner_vertex[np.stack([half_edge, half_edge - half_edge % 3 + (half_edge + 1) % 3])]
        locked = (flags[ends] & int(LOCKED)) != 0
        keeps_second = locked[1] | (~locked[0] & (ends[1] < ends[0]))
        removed: np.ndarray = np.where(keeps_second, ends[0], ends[1])
        return removed

    def _compact(self) -> bool:
        """Close the gaps that dead faces leave, once they are many; whether that was so. It renumbers the corners."""
        if self.live_faces >= LIVE_FRACTION * self.face_slots:
            return False
        state = self.state
        rank = self._live_rank[: self.face_slots]

        def mark(part: slice) -> None:
            wp.launch(
                collapse_kernels.mark_live_faces,
                dim=part.stop - part.start,
                inputs=[state.corner_vertex[3 * part.start : 3 * part.stop]],
                outputs=[rank[part]],
                device=self.device,
            )

        def move(part: slice) -> None:
            corners = slice(3 * part.start, 3 * part.stop)
            wp.launch(
                collapse_kernels.move_live_faces,
                dim=part.stop - part.start,
                inputs=[state.corner_vertex[corners], state.edge_cost[corners], state.seam[corners], rank[part]],
                outputs=[self._spare_corner_vertex, self._spare_edge_cost, self._spare_seam],
                device=self.device,
            )

        launch_parts(collapse_kernels.mark_live_faces, mark, self.face_slots, self.device, COMPACTED_FACES)
        wp.utils.array_scan(rank, rank, inclusive=True)
        launch_parts(collapse_kernels.move_live_faces, move, self.face_slots, self.device, COMPACTED_FACES)
        if state.wedges.channel_count > 0:
            wp.launch(
                attribute_kernels.move_corner_wedges,
                dim=self.face_slots,
                inputs=[state.corner_vertex, state.wedges.corner_wedge, rank],
                outputs=[self._spare_wedge],
                device=self.device,
            )
            wp.copy(state.wedges.corner_wedge, self._spare_wedge, count=3 * self.live_faces)
        self.face_slots = self.live_faces
        state.face_count.fill_(self.face_slots)
        # Copied back, not swapped: the recorded launches hold these arrays.
        half_edge_count = 3 * self.face_slots
        wp.copy(state.corner_vertex, self._spare_corner_vertex, count=half_edge_count)
        wp.copy(state.edge_cost, self._spare_edge_cost, count=half_edge_count)
        wp.copy(state.seam, self._spare_seam, count=half_edge_count)
        return True
