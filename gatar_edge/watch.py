"""Being watched over HTTP: /healthz and /metrics on loopback.

The loop publishes a snapshot a tick. HTTP is answered in a thread of its own, so that a hung loop can still be seen:
/healthz then says for how long there has been no tick.
"""

from __future__ import annotations

import http.server
import threading
from collections.abc import Callable
from typing import Any

import msgspec

from gatar_edge.errors import LinkError
from gatar_edge.health import Snapshot
from gatar_edge.metrics import exporter
from gatar_edge.transports.udp import parse_address
from gatar_edge.types import NS_PER_S

HUNG_NS = 2 * NS_PER_S  # without a tick
METRICS_HINT = "metrics need prometheus-client, which is not installed: pip install 'gatar-edge[metrics]'\n"


class HttpWatch:
    """Answers GET /healthz (200 or 503, JSON) and GET /metrics (Prometheus text). Raises LinkError for a used port."""

    def __init__(self, listen: str, clock_ns: Callable[[], int]) -> None:
        self._clock_ns = clock_ns
        self._snapshot: Snapshot | None = None
        self._metrics = exporter(lambda: self._snapshot)
        host, port = parse_address(listen, "watch.http")
        try:
            self._server = http.server.ThreadingHTTPServer((host, port), self._handler())
        except OSError as error:
            raise LinkError(
                f"watch.http cannot listen on {listen} ({error.strerror}): stop the program that uses it, "
                "or give another address"
            ) from error
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, name="watch", daemon=True)
        self._thread.start()

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens."""
        host, port = self._server.server_address[:2]
        return str(host), int(port)

    def published(self, t_ns: int, snapshot: Callable[[], Snapshot]) -> None:
        """From now on tell of this tick."""
        del t_ns  # the snapshot has it
        self._snapshot = snapshot()

    def close(self) -> None:
        """Stop answering."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def answer(self, path: str) -> tuple[int, str, bytes]:
        """Status, content type and body for a GET of `path`."""
        if path == "/healthz":
            problems = self._problems()
            body = {"ok": not problems, "problems": problems, "state": self._snapshot}
            return (503 if problems else 200), "application/json", msgspec.json.encode(body)
        if path == "/metrics":
            text = self._metrics()
            return (
                (501, "text/plain", METRICS_HINT.encode()) if text is None else (200, "text/plain; version=0.0.4", text)
            )
        return 404, "text/plain", b"/healthz or /metrics\n"

    def _problems(self) -> list[str]:
        snapshot = self._snapshot
        if snapshot is None:
            return ["no tick yet"]
        silent_ns = self._clock_ns() - snapshot.t_ns
        hung = [f"no tick for {silent_ns / NS_PER_S:.1f} s"] if silent_ns > HUNG_NS else []
        return hung + snapshot.problems

    def _handler(self) -> type[http.server.BaseHTTPRequestHandler]:
        answer = self.answer

        class Handler(http.server.BaseHTTPRequestHandler):
            timeout = 5  # for a client that connects and says nothing

            def do_GET(self) -> None:
                status, content_type, body = answer(self.path)
                self.send_response(status)
                self.send_header("Content-Type", content_type)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, format: str, *args: Any) -> None:
                """Say nothing: watching is no event."""

        return Handler
