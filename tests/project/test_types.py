"""The types of the code: what type checkers are kept from looking at, and what public functions say."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path

import pytest

import warpqem

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted(path for path in (ROOT / "warpqem").rglob("*.py") if "kernels" not in path.parts)


def test_what_is_ignored_has_its_code_and_its_reason():
    lines = [(path.name, line.strip()) for path in FILES for line in path.read_text("utf-8").splitlines()]
    ignored = [(name, line) for name, line in lines if re.search(r"#\s*type:\s*ignore", line)]
    assert [entry for entry in ignored if not re.search(r"# type: ignore\[[a-z-]+\]  # \w", entry[1])] == []


def public_functions(package: str) -> dict[str, object]:
    """Functions, methods and constructors among the public names of a package."""
    found: dict[str, object] = {}
    loaded = importlib.import_module(package)
    for name in loaded.__all__:
        value = getattr(loaded, name)
        if inspect.isfunction(value):
            found[name] = inspect.unwrap(value)
        elif inspect.isclass(value) and not issubclass(value, Exception):
            own = {key: part for key, part in vars(value).items() if inspect.isfunction(part) and key[0] != "_"}
            if value.__init__ is not object.__init__:
                own["__init__"] = value.__init__
            found |= {f"{name}.{key}": inspect.unwrap(part) for key, part in own.items()}
    return found


@pytest.mark.parametrize("package", ["warpqem", "warpqem.usd", "warpqem.costs", "warpqem.face", "warpqem.skinning"])
def test_public_functions_say_what_they_take_and_give(package):
    said = {name: inspect.get_annotations(function) for name, function in public_functions(package).items()}
    assert said
    bare = [(name, key) for name, kinds in said.items() for key, kind in kinds.items() if kind == "Any"]
    assert bare == []


def test_mypy_looks_at_all_but_the_kernels():
    tomllib = pytest.importorskip("tomllib", reason="Python 3.10 has no TOML reader")
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["mypy"]
    assert settings["strict"]
    own = [name for entry in settings["overrides"] for name in entry["module"] if name.startswith(warpqem.__name__)]
    assert own == ["warpqem.kernels.*"]
