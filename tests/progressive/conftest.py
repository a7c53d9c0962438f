"""Fixtures of the tests of hostile progressive files."""

from __future__ import annotations

from pathlib import Path

import pytest

import warpqem
from tests.support import meshes
from tests.support.progressive_files import NOTES
from warpqem.progressive import save


@pytest.fixture(scope="module")
def sphere() -> warpqem.ProgressiveMesh:
    return warpqem.build_progressive(*meshes.swaying_sphere(2, 3), device="cpu")


@pytest.fixture
def good(sphere, tmp_path) -> Path:
    save(sphere, tmp_path / "good.wpqm", NOTES)
    return tmp_path / "good.wpqm"
