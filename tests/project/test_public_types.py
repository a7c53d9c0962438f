"""What the annotations of the public names say."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import inspect
import re
from collections.abc import Iterator

import pytest

import warpqem

ROOMS = ("warpqem", *(f"warpqem.{room}" for room in warpqem._ROOMS))


def of_function(name: str, function: object) -> Iterator[tuple[str, str]]:
    for parameter, annotation in inspect.unwrap(function).__annotations__.items():
        yield f"{name}({parameter})", str(annotation)


def of_class(cls: type) -> Iterator[tuple[str, str]]:
    """The annotations of the public fields, properties and methods of a class and of its bases in warpqem."""
    for base in (base for base in cls.__mro__ if base.__module__.startswith("warpqem")):
        for name, annotation in vars(base).get("__annotations__", {}).items():
            if not name.startswith("_"):
                yield f"{cls.__name__}.{name}", str(annotation)
        for name, member in vars(base).items():
            # The constructor of a dataclass says what its fields say.
            if name.startswith("_") and (name not in ("__init__", "__call__") or dataclasses.is_dataclass(base)):
                continue
            if isinstance(member, property):
                member = member.fget
            elif isinstance(member, functools.cached_property):
                member = member.func
            elif isinstance(member, (classmethod, staticmethod)):
                member = member.__func__
            if inspect.isfunction(member):
                yield from of_function(f"{cls.__name__}.{name}", member)


def annotations(room: str) -> dict[str, str]:
    module = importlib.import_module(room)
    found: dict[str, str] = {}
    for name in module.__all__:
        public = getattr(module, name)
        if inspect.isclass(public):
            found |= of_class(public)
        elif callable(public):
            found |= of_function(name, public)
    return found


@pytest.mark.parametrize("room", ROOMS)
def test_no_public_annotation_is_any(room):
    assert {name: text for name, text in annotations(room).items() if re.search(r"\bAny\b", text)} == {}


def test_annotations_of_fields_properties_methods_and_functions_are_looked_at():
    found = annotations("warpqem") | annotations("warpqem.errors")
    for name in (
        "simplify(points)",
        "simplify(return)",
        "SimplifiedMesh.points",
        "SimplifiedMesh.measured(return)",
        "MemoryPlan.to_dict(return)",
        "BatchResult.report",
        "UnreachableTargetError.__init__(result)",
    ):
        assert name in found


def test_every_public_function_says_what_it_takes_and_gives():
    for room in ROOMS:
        module = importlib.import_module(room)
        functions = [getattr(module, name) for name in module.__all__ if inspect.isfunction(getattr(module, name))]
        for function in map(inspect.unwrap, functions):
            parameters = inspect.signature(function).parameters
            assert {*parameters, "return"} <= function.__annotations__.keys(), f"{room}.{function.__name__}"
