"""What the validators of USD and of NVIDIA find in a file."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Usd

Finding = tuple[str, str]


def usd_findings(path: Path) -> dict[Finding, str]:
    """Rule and place of all findings of all registered validators of USD, with a message of each."""
    validation = pytest.importorskip("pxr.UsdValidation")
    context = validation.ValidationContext(validation.ValidationRegistry().GetOrLoadAllValidators())
    found = {}
    for error in context.Validate(Usd.Stage.Open(str(path))):
        for site in error.GetSites() or [None]:
            prim = site.GetPrim() if site and (site.IsPrim() or site.IsProperty()) else None
            found[error.GetName(), str(prim.GetPath()) if prim else ""] = error.GetMessage()
    return found


def nvidia_findings(path: Path) -> dict[Finding, str]:
    """Rule and place of all findings of the default rules of NVIDIA's validator, with a message of each."""
    validation = pytest.importorskip("usd_validation_nvidia")
    found = {}
    for issue in validation.ValidationEngine().validate(str(path)).issues():
        place = getattr(issue.at, "prim_path", None) or getattr(issue.at, "path", None) or ""
        found[getattr(issue.rule, "__name__", str(issue.rule)), str(place).split(".")[0]] = issue.message
    return found
