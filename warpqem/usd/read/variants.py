"""Variants that are looked at instead of those that a file selects."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass

from pxr import Sdf, Usd

from warpqem.errors import OptionError
from warpqem.usd.read.open_stage import open_stage

__all__ = ["VariantChoice", "lost_variants", "open_stages", "select_variants"]

# SET=NAME, or /Prim/Path{SET=NAME} as USD writes paths into variants. Names of variants may hold - | and a leading dot.
CHOICE = re.compile(r"(?P<set>[\w:.|-]+)=(?P<name>[\w.|-]+)")
CHOICE_OF_PRIM = re.compile(rf"(?P<prim>/[^{{}}]*)\{{{CHOICE.pattern}\}}")

# Variants that a note names.
MAX_NAMED = 3


@dataclass(frozen=True)
class VariantChoice:
    """One variant.

    Attributes:
        set: Name of the variant set.
        name: Name of the variant.
        prim: Prim that has the set; None for the only one that does.
    """

    set: str
    name: str
    prim: Sdf.Path | None = None

    @classmethod
    def parse(cls, text: str) -> VariantChoice:
        """Read `SET=NAME` or `/Prim/Path{SET=NAME}`.

        Raises:
            OptionError: it is something else.
        """
        found = CHOICE.fullmatch(text) or CHOICE_OF_PRIM.fullmatch(text)
        prim = (found.groupdict().get("prim") if found else None) or None
        if found is None or (prim is not None and not Sdf.Path.IsValidPathString(prim)):
            raise OptionError(f"variant '{text}': expected SET=NAME, such as LOD=LOD1, or /Prim/Path{{SET=NAME}}")
        return cls(found["set"], found["name"], None if prim is None else Sdf.Path(prim))

    def __str__(self) -> str:
        """As it is written on the command line."""
        choice = f"{self.set}={self.name}"
        return choice if self.prim is None else f"{self.prim}{{{choice}}}"


def select_variants(stages: Sequence[Usd.Stage], variants: Sequence[str]) -> list[list[VariantChoice]]:
    """Select variants on every stage that has them, in the session layer, which no file is.

    They are selected one after the other, so that a set may come from a variant chosen before.

    Args:
        stages: The stages.
        variants: Choices as text, see `VariantChoice.parse`.

    Returns:
        For each stage what was selected, with the prims.

    Raises:
        OptionError: a choice is wrongly written; no stage has the set; several prims of a stage have it and the choice
            names none of them; or the set has no such variant.
    """
    selected: list[list[VariantChoice]] = [[] for _ in stages]
    for choice in map(VariantChoice.parse, variants):
        places = [_prims_with(stage, choice) for stage in stages]
        if not any(places):
            sets = sorted({name for stage in stages for prim in _prims(stage) for name in _set_names(prim)})
            known = f"; variant sets are {', '.join(sets)}" if sets else ""
            where = "no prim has a" if choice.prim is None else f"{choice.prim} has no"
            raise OptionError(f"variant {choice}: {where} variant set {choice.set!r}{known}")
        for stage, prims, chosen in zip(stages, places, selected, strict=True):
            if prims:
                chosen.append(_select(stage, prims, choice))
    return selected


def _prims(stage: Usd.Stage) -> list[Usd.Prim]:
    return list(stage.TraverseAll())


def _set_names(prim: Usd.Prim) -> list[str]:
    names: list[str] = prim.GetVariantSets().GetNames()
    return names


def _prims_with(stage: Usd.Stage, choice: VariantChoice) -> list[Usd.Prim]:
    if choice.prim is None:
        return [prim for prim in _prims(stage) if choice.set in _set_names(prim)]
    prim = stage.GetPrimAtPath(choice.prim)
    return [prim] if prim and choice.set in _set_names(prim) else []


def _select(stage: Usd.Stage, prims: Sequence[Usd.Prim], choice: VariantChoice) -> VariantChoice:
    if len(prims) > 1:
        paths = ", ".join(f"'{prim.GetPath()}{{{choice.set}={choice.name}}}'" for prim in prims[:3])
        more = f" and {len(prims) - 3} more" if len(prims) > 3 else ""
        raise OptionError(f"variant {choice}: {len(prims)} prims have this set; name one of them: {paths}{more}")
    [prim] = prims
    variants = prim.GetVariantSet(choice.set)
    if choice.name not in variants.GetVariantNames():
        known = ", ".join(variants.GetVariantNames()) or "none"
        raise OptionError(f"variant {choice}: the set {choice.set!r} of {prim.GetPath()} has the variants {known}")
    path = prim.GetPath()
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        variants.SetVariantSelection(choice.name)
    return VariantChoice(choice.set, choice.name, path)


def lost_variants(stage: Usd.Stage) -> list[str]:
    """A line that names the selected variants, which alone are in a flat file; none where there is no variant set."""
    prims = Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate))
    sets = [(prim, prim.GetVariantSet(name)) for prim in prims for name in _set_names(prim)]
    chosen = [
        f"{prim.GetPath()}{{{variants.GetName()}={variants.GetVariantSelection()}}}"
        for prim, variants in sets
        if len(variants.GetVariantNames()) > 1
    ]
    more = f" and {len(chosen) - MAX_NAMED} more" if len(chosen) > MAX_NAMED else ""
    named = ", ".join(chosen[:MAX_NAMED]) + more
    return [f"a flat file has no variant sets; of these it has what is selected: {named}"] if chosen else []


def open_stages(paths: Sequence[str | os.PathLike[str]], variants: Sequence[str] = ()) -> list[Usd.Stage]:
    """Open files, with variants selected on those that have them.

    Raises:
        StageError: a file cannot be read.
        OptionError: see `select_variants`.
    """
    stages = [open_stage(path) for path in paths]
    select_variants(stages, variants)
    return stages
