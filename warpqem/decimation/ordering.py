"""What every loop of passes over a mesh has: its log, the faces that are left, and what to do where it ends."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import numpy as np
import warp as wp

from warpqem.decimation.collapse_nodes import NodeRecorder
from warpqem.decimation.pass_steps import ROUNDS, PassSteps
from warpqem.decimation.pruning import ComponentDrop, Components

__all__ = ["Ordering"]


class Ordering(ABC):
    """Collapses the edges of one mesh state, pass by pass.

    Attributes:
        steps: what passes are made of.
        log: the collapses so far.
        face_slots: faces in the arrays, dead ones included.
        live_faces: faces that are left.
        drops: the pruned components.
        along: what is to come to the host along with how an ordering ended, if that takes a wait; None for nothing.
        brought: these arrays as they came; none where there was no wait.
    """

    def __init__(self, steps: PassSteps) -> None:
        self.steps = steps
        self.state, self.frames, self.model, self.device = steps.state, steps.frames, steps.model, steps.device
        self.log = steps.log
        self.face_slots = len(self.state.corner_vertex) // 3
        self.live_faces = self.face_slots
        self.drops: list[ComponentDrop] = []
        self.along: Callable[[], Sequence[wp.array]] | None = None
        self.brought: Sequence[np.ndarray] = ()

    @abstractmethod
    def run(
        self,
        target_faces: int,
        progress: Callable[[int], None] | None = None,
        recorder: NodeRecorder | None = None,
        components: Components | None = None,
    ) -> str:
        """Collapse until the target is met; small ones of ``components``, if given, may be pruned.

        ``progress`` is called with the live face count after each pass, ``recorder`` is shown what each pass merged.

        Returns:
            "target"; "max_error" when every edge left would exceed the model's error limit or is illegal, and at least
            one is held back by the limit alone; "no legal collapse" otherwise.
        """

    def collapse_count(self) -> int:
        """Collapses in the log."""
        return int(self.log.count.numpy()[0])

    def drop_components(self, components: Components, target_faces: int, cost_threshold: float) -> int:
        """Prune small components that cost no more than a threshold.

        Returns:
            The faces that went with them.
        """
        excess = self.live_faces - target_faces
        return self._note(components.drop(cost_threshold, excess, self.collapse_count()))

    def begin(self, components: Components | None) -> None:
        """Compute all costs, and prune the components that go before all else."""
        self.steps.compute_all_costs()
        if components is not None:
            self._note(components.drop_first())

    def _note(self, drops: list[ComponentDrop]) -> int:
        """Count pruned components; the faces that went with them."""
        self.drops += drops
        dropped = sum(drop.face_count for drop in drops)
        self.live_faces -= dropped
        return dropped

    def stop_reason(self) -> str:
        """Why no edge is left to collapse, as :meth:`run` says it; nothing may collapse after it."""
        held_back = not np.isinf(self.model.error_limit) and self._collapses_without_limit()
        return "max_error" if held_back else "no legal collapse"

    def _collapses_without_limit(self) -> bool:
        """Whether a collapse is legal once the error limit is lifted; computes all costs anew."""
        self.model.error_limit = np.inf
        self.steps.forget_launches()
        self.steps.compute_all_costs()
        launches = self.steps.launches(1)
        # Every edge is a candidate.
        self.steps.sample_step.fill_(1)
        self.steps.wanted.fill_(3 * self.face_slots)
        pass_number = int(self.steps.pass_number.numpy()[0])
        while True:
            pass_number += 1
            self.steps.pass_number.fill_(pass_number)
            launches.collect.run()
            if not launches.candidates[0].count.numpy().any():
                return False
            for i in range(ROUNDS):
                launches.choose[i % 2].run()
                count = int(launches.selected.count.numpy()[0])
                if self.steps.faces_removed[:count].numpy().any():
                    return True
                # None is legal: they are suspended, which leaves others to be selected.
                launches.commit[i % 2].run()
