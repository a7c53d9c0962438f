"""The parallel pass: cap, candidates, rounds of claim and commit, until the target is met.

A pass reads aloud as: price what moved, find the cap, collect the candidates under it, then for a few rounds: claim,
select, place, judge, commit; at last build the stars anew. Everything but the counts stays on the device.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

from warpqem.kernels import collapse as collapse_kernels
from warpqem.kernels import edge_cost as cost_kernels
from warpqem.kernels import independent_set as set_kernels
from warpqem.kernels import legality as legality_kernels
from warpqem.kernels.mesh_state import CollapseLog, CostModel, MeshState
from warpqem.order.stars import Stars
from warpqem.parallel import run_parts, thread_count

__all__ = ["Orderer"]

# Part of the edges that one pass may touch. More is faster and further from the serial greedy order.
CAP_FRACTION = 0.05
# Near the target a pass looks at no more edges than collapses are still to do, but at this many at least,
# or the last passes would each do one collapse.
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
# On a GPU a work list of unknown length is walked by this many lanes: enough to fill any device of today.
GPU_LANES = 65536


class Orderer:
    """Collapses the edges of one mesh state, pass by pass."""

    def __init__(self, state: MeshState, stars: Stars, model: CostModel, face_count: int, device: str) -> None:
        self.state, self.stars, self.model, self.device = state, stars, model, device
        self.face_slots = face_count  # faces in the arrays, dead ones included
        self.live_faces = face_count
        self.pass_index = 0
        vertex_count, key_count = state.position.shape
        self.flip_tolerance = int(FLIP_FRACTION * key_count)
        self.lanes = 1 if wp.get_device(device).is_cpu else GPU_LANES
        self.log = self._new_log(vertex_count)
        self._recorded: dict[tuple, wp.Launch] = {}
        self._recorded_parts: dict[tuple, list[wp.Launch]] = {}
        self._pass_number = wp.zeros(1, dtype=wp.int32, device=device)
        self._pass_begin = wp.zeros(1, dtype=wp.int32, device=device)
        self._histogram = wp.zeros(HISTOGRAM_BINS, dtype=wp.int32, device=device)
        self._cap = wp.zeros(1, dtype=wp.int32, device=device)
        self._claim = wp.full(vertex_count, set_kernels.UNCLAIMED, dtype=wp.int64, device=device)
        self._mask = wp.zeros(vertex_count, dtype=wp.int32, device=device)
        # Winners share no vertex, so there are V / 2 at most; an edge stands at one of its two half-edges.
        most_winners = vertex_count // 2 + 1
        self._candidates = [self._new_list(3 * face_count) for _ in range(2)]
        self._winners = self._new_list(most_winners)
        self._faces_removed = wp.zeros(most_winners, dtype=wp.int32, device=device)
        self._target = wp.empty((most_winners, key_count), dtype=wp.vec3, device=device)
        self._anchor = wp.empty(most_winners, dtype=wp.float32, device=device)
        self._live_rank = wp.empty(face_count, dtype=wp.int32, device=device)
        self._spare_corner_vertex = wp.empty_like(state.corner_vertex)
        self._spare_edge_cost = wp.empty_like(state.edge_cost)
        self._spare_seam = wp.empty_like(state.seam)

    def _new_list(self, capacity: int) -> set_kernels.EdgeList:
        edges = set_kernels.EdgeList()
        edges.count = wp.zeros(1, dtype=wp.int32, device=self.device)
        edges.half_edge = wp.empty(capacity, dtype=wp.int32, device=self.device)
        return edges

    def _new_log(self, capacity: int) -> CollapseLog:
        log = CollapseLog()
        log.count = wp.zeros(1, dtype=wp.int32, device=self.device)
        for name in ("kept", "removed", "left_wing", "right_wing", "faces_removed", "pass_index"):
            setattr(log, name, wp.empty(capacity, dtype=wp.int32, device=self.device))
        for name in ("cost", "error"):
            setattr(log, name, wp.empty(capacity, dtype=wp.float32, device=self.device))
        return log

    def _sweep(self, kernel: wp.Kernel, inputs: list, outputs: list | None = None) -> None:
        """Launch a kernel that walks a list of a length known to the device only.

        The launch is recorded, and a replay costs a fifth of a launch. Its arrays stay the same, but for which of the
        two candidate lists comes first; whole numbers among its inputs may change.
        """
        key = (kernel, self._candidates[0].half_edge.ptr, *(x for x in inputs if isinstance(x, int)))
        command = self._recorded.get(key)
        if command is None:
            command = wp.launch(
                kernel,
                dim=self.lanes,
                inputs=[*inputs, self.lanes],
                outputs=outputs or [],
                device=self.device,
                record_cmd=True,
            )
            self._recorded[key] = command
        command.launch()

    def _split_sweep(self, kernel: wp.Kernel, inputs: list) -> None:
        """Sweep with a kernel whose lanes write apart from each other, over all CPU threads."""
        threads = thread_count(self.device)
        key = (kernel, *(x for x in inputs if isinstance(x, int)))
        commands = self._recorded_parts.get(key)
        if commands is None:
            commands = [
                wp.launch(
                    kernel,
                    dim=self.lanes,
                    inputs=[*inputs, part, self.lanes * threads],
                    device=self.device,
                    record_cmd=True,
                )
                for part in range(threads)
            ]
            self._recorded_parts[key] = commands
        run_parts([command.launch for command in commands])

    def run(self, target_faces: int, progress: Callable[[int], None] | None = None) -> str:
        """Collapse until the target is met; ``progress`` is called with the live face count after each pass.

        Returns:
            "target"; "max_error" when every edge left would exceed the model's error limit or is illegal, and at least
            one is held back by the limit alone; "no legal collapse" otherwise.
        """
        self._price_all()
        cap_fraction = CAP_FRACTION
        while self.live_faces > target_faces:
            candidate_count, collapsed = self._run_pass(target_faces, cap_fraction)
            if candidate_count == 0 and cap_fraction >= 1.0:
                return "max_error" if self._is_limited() else "no legal collapse"
            # No legal winner under the cap: look further, at all edges, until every one has been refused.
            cap_fraction = CAP_FRACTION if collapsed else min(1.0, 4.0 * cap_fraction)
            if progress:
                progress(self.live_faces)
        return "target"

    def _is_limited(self) -> bool:
        """Whether the error limit holds back an edge: without it more edges have a price than lie asleep.

        Lifts the limit and prices all edges anew, so nothing may collapse after it.
        """
        half_edge_count = 3 * self.face_slots
        asleep = np.isfinite(self.state.edge_cost.numpy()[:half_edge_count]).sum()
        self.model.error_limit = np.inf
        self._recorded_parts.clear()
        self._price_all()
        return bool(np.isfinite(self.state.edge_cost.numpy()[:half_edge_count]).sum() > asleep)

    def _price_all(self) -> None:
        self._split_sweep(cost_kernels.price_all_edges, [self.state, self.model, 3 * self.face_slots])

    def _run_pass(self, target_faces: int, cap_fraction: float) -> tuple[int, int]:
        """One pass; the numbers of candidates and of collapses made."""
        self.pass_index += 1
        self._pass_number.fill_(self.pass_index)
        remaining = self.live_faces - target_faces
        candidate_count = self._collect_candidates(remaining, cap_fraction)
        begin = int(self.log.count.numpy()[0])
        wp.copy(self._pass_begin, self.log.count)
        # A candidate removes two faces at most: only a pass that could overshoot has to count its winners.
        trim = 2 * candidate_count > remaining
        for _ in range(ROUNDS):
            removed = self._run_round(remaining, trim)
            remaining -= removed
            if remaining <= 0:
                break
        end = int(self.log.count.numpy()[0])
        if end > begin:
            self.live_faces -= int(self.log.faces_removed.numpy()[begin:end].sum())
            self._compact()
            self.stars.build(self.state.corner_vertex, 3 * self.face_slots)
            self._split_sweep(cost_kernels.reprice_moved_stars, [self.state, self.model, self.log, self._pass_begin])
            self._sweep(cost_kernels.wake_neighbourhoods, [self.state, self.log, self._pass_begin])
        return candidate_count, end - begin

    def _collect_candidates(self, remaining: int, cap_fraction: float) -> int:
        """Fill the list of candidates with the cheapest edges; their number."""
        half_edge_count = 3 * self.face_slots
        wanted = int(cap_fraction * 1.5 * self.live_faces)
        if cap_fraction < 1.0:
            wanted = max(LEAST_CANDIDATES, min(wanted, remaining // 2))
        candidates = self._candidates[0]
        candidates.count.zero_()
        # After a pass without a winner every edge counts: the few that are awake may be missing from a sample.
        sampled = cap_fraction == CAP_FRACTION and half_edge_count >= SAMPLE_STEP * LEAST_SAMPLE
        step = SAMPLE_STEP if sampled else 1
        self._sweep(set_kernels.count_costs, [self.state.edge_cost, half_edge_count, step], [self._histogram])
        wp.launch(
            set_kernels.find_cap,
            dim=1,
            inputs=[max(1, wanted // step)],
            outputs=[self._histogram, self._cap],
            device=self.device,
        )
        self._sweep(set_kernels.collect_candidates, [self.state.edge_cost, half_edge_count, self._cap], [candidates])
        return int(candidates.count.numpy()[0])

    def _run_round(self, remaining: int, trim: bool) -> int:
        """Claim, select, place, judge and commit once; the faces removed when ``trim`` is set, else 0."""
        state, candidates, winners = self.state, self._candidates[0], self._winners
        winners.count.zero_()
        self._sweep(set_kernels.claim_vertices, [state, candidates], [self._claim])
        self._sweep(set_kernels.select_winners, [state, candidates, self._claim], [winners])
        self._sweep(set_kernels.withdraw_claims, [state, candidates], [self._claim])
        self._sweep(legality_kernels.place_winners, [state, self.model, winners], [self._target, self._anchor])
        self._sweep(
            legality_kernels.judge_winners, [state, winners, self._target, self.flip_tolerance], [self._faces_removed]
        )
        removed = self._trim_winners(remaining) if trim else 0
        self._sweep(
            collapse_kernels.commit_winners,
            [state, winners, self._faces_removed, self._target, self._anchor, self._pass_number],
            [self._mask, self.log],
        )
        self._candidates.reverse()
        self._candidates[0].count.zero_()
        self._sweep(
            set_kernels.shrink_candidates, [state, self._mask, self._pass_number, candidates], [self._candidates[0]]
        )
        return removed

    def _trim_winners(self, remaining: int) -> int:
        """Drop the dearest winners beyond the ``remaining`` faces to remove; the faces that the others remove."""
        count = int(self._winners.count.numpy()[0])
        faces = self._faces_removed.numpy()[:count]
        half_edge = self._winners.half_edge.numpy()[:count]
        order = np.lexsort((half_edge, self.state.edge_cost.numpy()[half_edge]))
        removed_before = np.cumsum(faces[order]) - faces[order]
        faces[order[removed_before >= remaining]] = 0
        if not self._faces_removed.device.is_cpu:
            self._faces_removed[:count].assign(faces)
        return int(faces.sum())

    def _compact(self) -> None:
        """Close the gaps that dead faces leave, once they are many."""
        if self.live_faces >= LIVE_FRACTION * self.face_slots:
            return
        state = self.state
        rank = self._live_rank[: self.face_slots]
        wp.launch(
            collapse_kernels.mark_live_faces,
            dim=self.face_slots,
            inputs=[state.corner_vertex],
            outputs=[rank],
            device=self.device,
        )
        wp.utils.array_scan(rank, rank, inclusive=True)
        wp.launch(
            collapse_kernels.move_live_faces,
            dim=self.face_slots,
            inputs=[state.corner_vertex, state.edge_cost, state.seam, rank],
            outputs=[self._spare_corner_vertex, self._spare_edge_cost, self._spare_seam],
            device=self.device,
        )
        self.face_slots = self.live_faces
        # Copied back, not swapped: the recorded launches hold these arrays.
        half_edge_count = 3 * self.face_slots
        wp.copy(state.corner_vertex, self._spare_corner_vertex, count=half_edge_count)
        wp.copy(state.edge_cost, self._spare_edge_cost, count=half_edge_count)
        wp.copy(state.seam, self._spare_seam, count=half_edge_count)
