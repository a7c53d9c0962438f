"""Pages in headless Chromium, WebGL in software."""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from PIL import Image

CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
FLAGS = ["--no-sandbox", "--disable-gpu", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
READY = "window.warpqem && window.warpqem.ready"


@contextmanager
def open_page(browser: Any, address: str, *, ready: str = READY, **options: Any) -> Iterator[Any]:
    """A page, paused unless asked otherwise; at the end its console is free of errors and the network was not used."""
    context = browser.new_context(**{"viewport": {"width": 900, "height": 700}, "reduced_motion": "reduce", **options})
    page = context.new_page()
    errors: list[str] = []
    requests: list[str] = []
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(address)
    page.wait_for_function(ready)
    yield page
    assert errors == []
    assert [url for url in requests if url.startswith("http")] == []
    context.close()


def picture(page: Any) -> np.ndarray:
    """The pixels of the view, when it shows what was asked for last."""
    page.wait_for_function("!window.warpqem.state.dirty")
    shot = Image.open(io.BytesIO(page.locator("#canvas").screenshot())).convert("RGB")
    return np.asarray(shot).astype(int)


def changed(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether more than the blending of labels with the view differs."""
    return bool((np.abs(after - before).sum(axis=-1) > 30)[60:].any())


def state(page: Any, name: str) -> Any:
    """A value of the page's state."""
    return page.evaluate(f"window.warpqem.state.{name}")
