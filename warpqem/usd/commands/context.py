"""What the runs over a stage, and the levels of a mesh, share."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from pxr import Usd

import warpqem
from warpqem.options import target_count
from warpqem.pipeline.memory_plan import MemoryPlan
from warpqem.usd.commands.mesh_job import MeshJob
from warpqem.usd.commands.simplify_options import SimplifyOptions
from warpqem.usd.read.open_stage import MeshSelection

__all__ = ["CORE_SHARE", "Announce", "Context", "Progress", "SharedOrder", "part_of"]

# How much of a mesh's progress is the core's; the rest is for what is transferred, written and measured.
CORE_SHARE = 0.7

Progress = Callable[[float, str], None]
Announce = Callable[[str, MemoryPlan], None]


def part_of(progress: Progress, start: float, share: float) -> Progress:
    """The progress of a part that begins at ``start`` and is so much of the whole."""
    return lambda fraction, text: progress(start + share * fraction, text)


@dataclass(frozen=True)
class Context:
    """What all runs over a stage share.

    Attributes:
        stage: The input.
        selection: The meshes to be simplified.
        options: What to do.
        folder: Where the output is going to be; None for a layer in memory.
        progress: Called with the fraction done and what is being done.
        announce: Called with the plan of each mesh, before the work on it; None where nobody is.
        cleanup: Ends when all is saved.
    """

    stage: Usd.Stage
    selection: MeshSelection
    options: SimplifyOptions
    folder: Path | None
    progress: Progress
    announce: Announce | None
    cleanup: ExitStack


@dataclass
class SharedOrder:
    """What all levels of one mesh share, from the first level on.

    Attributes:
        min_ratio: Ratio of the coarsest level.
        min_faces: Faces of the coarsest level, where no ratio is given.
        job: The mesh made ready.
        order: Its ordering.
        announced: Its memory plan has been announced.
    """

    min_ratio: float | None = None
    min_faces: int = 1
    job: MeshJob | None = None
    order: warpqem.LevelOrder | None = None
    announced: bool = False

    def least(self, face_count: int) -> int:
        """Faces of the coarsest level of a mesh of so many."""
        return self.min_faces if self.min_ratio is None else target_count(self.min_ratio, face_count)
