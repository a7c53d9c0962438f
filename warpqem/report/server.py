"""A page from a server of this machine, for this machine alone."""

from __future__ import annotations

import json
import re
import secrets
import threading
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from warpqem.errors import StageError

__all__ = ["HOST", "PageServer"]

# Other machines cannot reach it.
HOST = "127.0.0.1"
# Of other programs of this machine, only those that were told the address may look.
TOKEN_BYTES = 18


class PageServer:
    """Serves a page and its levels until it is stopped.

    Attributes:
        address: of the page.
    """

    def __init__(self, page: str, level: Callable[[int], dict[str, Any]] | None = None, port: int = 0) -> None:
        """Take a port; nothing is answered before `serve`.

        Args:
            page: HTML text.
            level: gives what is at ``level/INDEX``, or raises IndexError; None where there is nothing.
            port: 0 for any that is free.

        Raises:
            StageError: the port is taken.
        """
        try:
            self._server = _Server((HOST, port), _Handler)
        except OSError as error:
            raise StageError(f"port {port}: cannot be used ({error.strerror or error})") from error
        token = secrets.token_urlsafe(TOKEN_BYTES)
        own_port = self._server.server_address[1]
        self.address = f"http://{HOST}:{own_port}/{token}/"
        self._server.site = _Site(f"/{token}/", f"{HOST}:{own_port}", page.encode("utf-8"), level)

    def serve(self) -> None:
        """Answer until `stop` is called or the program is interrupted."""
        try:
            self._server.serve_forever()
        finally:
            self._server.server_close()

    def stop(self) -> None:
        """End `serve`, from another thread."""
        self._server.shutdown()


class _Site:
    """What there is to be had, and under which path."""

    def __init__(self, root: str, host: str, page: bytes, level: Callable[[int], dict[str, Any]] | None) -> None:
        self.root, self.host, self.page, self._level = root, host, page, level
        # Warp and the level's arrays are used by one request at a time.
        self._lock = threading.Lock()

    def find(self, path: str) -> tuple[bytes, str] | None:
        """Content and its type; None where there is nothing."""
        # In constant time, so that the token cannot be found letter by letter.
        if not secrets.compare_digest(path[: len(self.root)].encode("utf-8"), self.root.encode("utf-8")):
            return None
        rest = path[len(self.root) :]
        if not rest:
            return self.page, "text/html; charset=utf-8"
        found = re.fullmatch(r"level/(\d{1,9})", rest, re.ASCII)
        if found is None or self._level is None:
            return None
        with self._lock:
            try:
                value = self._level(int(found[1]))
            except IndexError:
                return None
        return json.dumps(value, allow_nan=False).encode("utf-8"), "application/json"


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    site: _Site


class _Handler(BaseHTTPRequestHandler):
    server_version = "warpqem"
    sys_version = ""
    server: _Server

    def do_GET(self) -> None:
        site = self.server.site
        # A page elsewhere may name this machine by a name of its own (DNS rebinding); its requests carry that name.
        found = site.find(self.path) if self.headers.get("Host") == site.host else None
        if found is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        content, kind = found
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: the terminal is the command's."""
