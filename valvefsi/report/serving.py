"""A page on a run that goes on, served to this machine alone: no request is answered without the token in its path."""

from __future__ import annotations

import json
import secrets
import sys
import threading
import time
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl, urlsplit

from valvefsi.errors import CaseError, reason_of
from valvefsi.io.folder import request_stop

if TYPE_CHECKING:
    from valvefsi.report.live import LiveRun

ADDRESS = "127.0.0.1"
HOSTS = (ADDRESS, "localhost")
"""Names of this machine in a request, before the port: of another one, a page of a stranger has sent it (DNS
rebinding)."""
PERIOD_S = 2.0
"""Time between two questions of an open page, as in page.live.js [s]."""


class PageServer(ThreadingHTTPServer):
    """Serves the page on a run at a random port of 127.0.0.1.

    What reads a run is loaded when it is first asked for: a page that nobody looks at costs the run next to nothing.

    Args:
        folder: Folder of the run.
        trust: Whether Python files of materials may be run.

    Attributes:
        token: Without it in the path a request is refused.
    """

    daemon_threads = True

    def __init__(self, folder: Path, *, trust: bool = False) -> None:
        super().__init__((ADDRESS, 0), Handler)
        self.folder, self.trust = Path(folder), trust
        self.token, self.answered = secrets.token_urlsafe(24), 0.0
        self.found: LiveRun | None = None
        self.one_at_a_time = threading.Lock()

    @property
    def run(self) -> LiveRun:
        """The run.

        Raises:
            CaseError: The folder is a file, or holds something else.
        """
        with self.one_at_a_time:
            if self.found is None:
                from valvefsi.report.live import LiveRun

                self.found = LiveRun(self.folder, trust=self.trust)
            return self.found

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{ADDRESS}:{self.server_port}/{self.token}/"

    def linger(self) -> None:
        """Wait until an open page has asked once more."""
        asked = time.monotonic()
        if asked - self.answered < 2.0 * PERIOD_S:
            while self.answered <= asked and time.monotonic() - asked < 2.0 * PERIOD_S:
                time.sleep(0.05)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Pass over a browser that goes away while it is answered."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class Handler(BaseHTTPRequestHandler):
    """Answers one request."""

    server: PageServer
    protocol_version = "HTTP/1.1"
    timeout = 30.0

    def do_GET(self) -> None:
        """Give the page, or what is new of the run."""
        match self._asked():
            case None:
                return
            case "":
                from valvefsi.report.writing import live_html

                page, view = self.server.run.page()
                self._answer(HTTPStatus.OK, live_html(page, view), "text/html; charset=utf-8")
            case "state":
                self._json(self._news())
                self.server.answered = time.monotonic()
            case _:
                self._answer(HTTPStatus.NOT_FOUND, "there is no such page")

    def do_POST(self) -> None:
        """Ask the run to stop."""
        self.close_connection = True
        match self._asked():
            case None:
                return
            case "stop":
                self._json({"said": self._stop()})
            case _:
                self._answer(HTTPStatus.NOT_FOUND, "there is no such request")

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing."""

    def _asked(self) -> str | None:
        """Return what is asked for; refuse a request without the token, or to another host than this page's."""
        try:
            host = urlsplit(f"//{self.headers.get('Host', '')}")
            own = host.hostname in HOSTS and host.port == self.server.server_port
        except ValueError:
            own = False
        token, _, asked = urlsplit(self.path).path.lstrip("/").partition("/")
        if secrets.compare_digest(token.encode(), self.server.token.encode()) and own:
            return asked
        self.close_connection = True
        self._answer(
            HTTPStatus.FORBIDDEN,
            "refused: the whole address that valvefsi watch has printed is needed, its port included (a tunnel: "
            f"ssh -L {self.server.server_port}:{ADDRESS}:{self.server.server_port})",
        )
        return None

    def _news(self) -> dict[str, Any]:
        try:
            return self.server.run.news(dict(parse_qsl(urlsplit(self.path).query)))
        except OSError as error:
            return {"error": f"{self.server.folder} cannot be read: {reason_of(error)}"}

    def _stop(self) -> str:
        try:
            request_stop(self.server.folder)
        except CaseError as error:
            return str(error)
        except OSError as error:
            return f"the request cannot be written: {reason_of(error)}"
        return "The run is asked to stop."

    def _json(self, said: dict[str, Any]) -> None:
        self._answer(HTTPStatus.OK, json.dumps(said), "application/json")

    def _answer(self, status: HTTPStatus, text: str, kind: str = "text/plain; charset=utf-8") -> None:
        body = text.encode()
        self.send_response(status)
        headers = {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            "Content-Security-Policy": "frame-ancestors 'none'",
        }
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)
