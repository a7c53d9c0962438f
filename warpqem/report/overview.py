"""An overview of many assets as one HTML file: a table that can be sorted and searched, with pictures."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image

from warpqem.printable import printable
from warpqem.report.page import asset_text, page_json, script_text

__all__ = ["Asset", "overview_page"]

# Of JPEG, 0 to 100: more does not show at the size of these pictures.
QUALITY = 84


@dataclass(frozen=True)
class Asset:
    """One row.

    Attributes:
        name: of the input.
        status: "done", "partial", "failed" or "skipped".
        faces: triangles before; 0 where that is not known.
        faces_after: triangles after.
        verdict: "good", "look" or "poor", of the worst mesh; empty where that is not known.
        reason: why it is not good.
        rms: largest measured RMS of a mesh, in % of its diagonal; None where that is not known.
        hausdorff: largest measured distance of a mesh, likewise.
        flips: faces a frame that oppose the input, of all meshes together; None where that is not known.
        seconds: wall-clock time.
        message: what went wrong; empty where nothing did.
        pictures: before and after, (height, width, 3) uint8 sRGB; empty for none.
        link: address of the output, relative to the page; empty for none.
        page: address of its own report, likewise.
    """

    name: str
    status: str
    faces: int = 0
    faces_after: int = 0
    verdict: str = ""
    reason: str = ""
    rms: float | None = None
    hausdorff: float | None = None
    flips: float | None = None
    seconds: float = 0.0
    message: str = ""
    pictures: Sequence[np.ndarray] = ()
    link: str = ""
    page: str = ""


def overview_page(title: str, assets: Sequence[Asset], notes: Sequence[str] = ()) -> str:
    """The HTML text; equal arguments give equal text."""
    rows = [{**vars(asset), "pictures": [_as_address(picture) for picture in asset.pictures]} for asset in assets]
    parts = {
        "TITLE": html.escape(printable(title)),
        "STYLE": asset_text("page.css"),
        "DATA": page_json({"assets": rows, "notes": list(notes)}),
        "PAGE": script_text("overview.js"),
    }
    pieces = asset_text("overview.html").split("%%")
    return "".join(parts[piece] if index % 2 else piece for index, piece in enumerate(pieces))


def _as_address(picture: np.ndarray) -> str:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", quality=QUALITY, subsampling=0, optimize=True)
    return "data:image/jpeg;base64," + base64.b64encode(file.getvalue()).decode("ascii")
