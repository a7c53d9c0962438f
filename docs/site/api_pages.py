"""Pages of the API reference: a page for each public module, with its names in order."""

from __future__ import annotations

import importlib

__all__ = ["MODULES", "api_pages"]

# What users import from, and what each is for; what is in other modules is an inner matter.
MODULES = {
    "warpqem": "simplifying arrays, levels, many meshes, batches",
    "warpqem.options": "the options that these take by keyword",
    "warpqem.costs": "cost models, importance, attributes in the costs",
    "warpqem.errors": "every exception",
    "warpqem.face": "feature points of faces, retargeting",
    "warpqem.measure": "distances, slide, texture, shading, colours",
    "warpqem.picture": "pictures of meshes",
    "warpqem.progressive": "every level of a mesh, in memory and in files",
    "warpqem.report": "pages that show meshes in motion",
    "warpqem.skinning": "skins, joints and blend shapes",
    "warpqem.usd": "stages in and out",
}
# The module has inner names in its `__all__`, too.
NAMES = {"warpqem.options": ("MeshOptions", "MethodOptions")}


def api_pages() -> dict[str, str]:
    """The pages by their names."""
    pages = {f"api/{module}.md": _page(module) for module in MODULES}
    rows = "\n".join(f"| [`{module}`]({module}.md) | {what} |" for module, what in MODULES.items())
    pages["api/README.md"] = (
        "# Python API\n\nMade from the docstrings. `import warpqem` is enough to use every module below; "
        "[Python](../python.md) is the guide to them. Other modules are internal.\n\n"
        f"| module | what is in it |\n|---|---|\n{rows}\n"
    )
    return pages


def public_names(module: str) -> list[str]:
    """The names that a page shows: functions and classes in order, then constants."""
    names = NAMES.get(module) or tuple(name for name in importlib.import_module(module).__all__ if name[0] != "_")
    return sorted(names, key=lambda name: (name.isupper(), name[0].isupper(), name.lower()))


def _page(module: str) -> str:
    # Of the module its docstring alone, below the title of the page.
    about = f"::: {module}\n    options: {{members: false, show_root_heading: false, show_root_toc_entry: false}}"
    entries = [f"::: {module}.{name}" for name in public_names(module)]
    return "\n\n".join([f"# {module}", about, *entries]) + "\n"
