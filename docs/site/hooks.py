"""Pages that MkDocs makes beside those in ``docs/``, and links that lead from one to the other.

The pages are also read in a checkout, where their links lead to files; on the site such links lead to pages.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[2]
# MkDocs runs this file by its path; its neighbours and warpqem are found from the checkout.
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from docs.site.api_pages import api_pages  # noqa: E402  # after the path
from docs.site.cli_page import cli_page  # noqa: E402
from docs.site.notebook_page import notebook_page  # noqa: E402

# Files of the checkout, as links in pages name them from the root, and the pages that show them.
SHOWN_AS = {
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "docs/simplify.ipynb": "notebook.md",
}
# Files that the site offers as they are.
OFFERED = ("examples/blender_simplify.py",)
# Code so short that it fits a line of a phone: an option is not broken at its hyphens.
SHORT_CODE = re.compile(r"<code>([^<>]{1,24})</code>")
LINK = re.compile(r"\]\((?!https?:|#)([^)#\s]+)(#[^)\s]*)?\)")


def on_files(files: Any, config: Any) -> Any:
    """Add the pages and files that are made or lie outside of ``docs/``."""
    texts = {
        "contributing.md": (ROOT / "CONTRIBUTING.md").read_text("utf-8"),
        "changelog.md": (ROOT / "CHANGELOG.md").read_text("utf-8"),
        "cli.md": cli_page(),
        **api_pages(),
    }
    texts["notebook.md"], pictures = notebook_page(ROOT / "docs" / "simplify.ipynb")
    for name, content in {**texts, **pictures}.items():
        files.append(File.generated(config, name, content=content))
    for name in OFFERED:
        # Python files of `docs/` are left out; this one is wanted.
        files.append(File.generated(config, f"{name}.txt", content=(ROOT / name).read_text("utf-8")))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Lead links to files of the checkout to the pages that show them."""
    source = page.file.src_uri
    here = {shown: name for name, shown in SHOWN_AS.items()}.get(source, f"docs/{source}")
    return LINK.sub(lambda link: _lead(link, here, source), markdown)


def on_page_content(html: str, **_: Any) -> str:
    """Keep short code on one line."""
    return SHORT_CODE.sub(r'<code class="short">\1</code>', html)


def _lead(link: re.Match[str], here: str, source: str) -> str:
    """The link as the site has it; `here` is the file in the checkout, `source` that of the page."""
    target = _joined(here, link[1])
    if target in OFFERED:
        shown = f"{target}.txt"
    elif target in SHOWN_AS and not (source == "notebook.md" and target.endswith(".ipynb")):
        shown = SHOWN_AS[target]
    elif target.startswith("docs/"):
        shown = target.removeprefix("docs/")
    else:
        return link[0]
    return f"]({'../' * source.count('/')}{shown}{link[2] or ''})"


def _joined(page: str, target: str) -> str:
    """A link of a page as a path from the root of the checkout."""
    parts = page.split("/")[:-1]
    for part in target.split("/"):
        if part == "..":
            del parts[-1:]
        elif part != ".":
            parts.append(part)
    return "/".join(parts)
