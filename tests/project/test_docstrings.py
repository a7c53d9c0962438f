"""Examples of public docstrings run, and show what they say."""

from __future__ import annotations

import doctest
import importlib
import inspect
from collections.abc import Iterator
from typing import Any

import pytest

import warpqem

ROOMS = ("costs", "face", "measure", "picture", "progressive", "report", "skinning", "usd")


def public() -> Iterator[tuple[str, Any]]:
    """Public names, those of the rooms behind their rooms, with what they name."""
    modules = {"warpqem": warpqem, **{f"warpqem.{room}": importlib.import_module(f"warpqem.{room}") for room in ROOMS}}
    for module, loaded in modules.items():
        for name in loaded.__all__:
            yield f"{module}.{name}", getattr(loaded, name)


def examples() -> dict[str, doctest.DocTest]:
    """Docstrings with examples by what they are about."""
    found = {}
    for name, value in public():
        if (inspect.isfunction(value) or inspect.isclass(value)) and ">>>" in (value.__doc__ or ""):
            found[name] = doctest.DocTestParser().get_doctest(inspect.getdoc(value) or "", {}, name, None, None)
    return found


EXAMPLES = examples()


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_example_of_a_docstring_shows_what_it_says(desk, name):
    said: list[str] = []
    failed, tried = doctest.DocTestRunner(verbose=False).run(EXAMPLES[name], out=said.append)
    assert tried > 1
    assert failed == 0, "".join(said)


def test_what_most_people_call_has_an_example():
    wanted = {"simplify", "simplify_levels", "simplify_many", "order_levels", "build_progressive", "load", "plan"}
    assert {f"warpqem.{name}" for name in wanted} <= EXAMPLES.keys()
    assert {"warpqem.usd.simplify_stage", "warpqem.usd.inspect_stage", "warpqem.measure.compare"} <= EXAMPLES.keys()
