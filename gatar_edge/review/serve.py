"""A folder of runs in the browser: a list, a page for each, and a mission that is being recorded, live.

Only files ending in .mcap below the folder are served, by names from the list. Pages are kept until their log changes.
"""

from __future__ import annotations

import html
import threading
from collections import OrderedDict
from dataclasses import dataclass, field
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote, urlsplit

import msgspec

from gatar_edge.errors import LinkError, LogError
from gatar_edge.review.reader import LogReader
from gatar_edge.review.report import asset, render
from gatar_edge.review.story import read_story
from gatar_edge.review.summary import run_of

MAX_LISTED = 500
MAX_KEPT = 8
_STYLE = """
main { max-width: 1000px; margin: 0 auto; padding: 24px clamp(14px, 3vw, 40px); }
td a { color: inherit; font-weight: 560; text-underline-offset: 3px; }
"""


@dataclass(slots=True)
class Library:
    """The logs of one folder, and what was made of them."""

    folder: Path
    _kept: OrderedDict[tuple[str, int, int], dict[str, Any]] = field(default_factory=OrderedDict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def logs(self) -> list[Path]:
        """All logs, the newest first."""
        found = [path for path in self.folder.rglob("*.mcap") if path.is_file()]
        return sorted(found, key=lambda path: path.stat().st_mtime_ns, reverse=True)[:MAX_LISTED]

    def find(self, name: str) -> Path | None:
        """The log of that name in the list; None for any other, so that nothing else can be asked for."""
        return next((path for path in self.logs() if str(path.relative_to(self.folder)) == name), None)

    def story(self, path: Path) -> dict[str, Any]:
        """The data of a page; made once for each state of the log. Raises LogError."""
        status = path.stat()
        key = (str(path), status.st_mtime_ns, status.st_size)
        with self._lock:  # one at a time: a browser asks again while the first answer is made
            if key not in self._kept:
                self._kept[key] = read_story(LogReader(path, salvage=True))
                while len(self._kept) > MAX_KEPT:
                    self._kept.popitem(last=False)
            return self._kept[key]


class Server(ThreadingHTTPServer):
    """Serves one library."""

    daemon_threads = True

    def __init__(self, address: tuple[str, int], library: Library) -> None:
        self.library = library
        super().__init__(address, Handler)


class Handler(BaseHTTPRequestHandler):
    """`/` the list, `/run/NAME` a page, `/data/NAME` what a live page asks for."""

    server: Server
    timeout = 30

    def do_GET(self) -> None:
        """Answer one request."""
        path = unquote(urlsplit(self.path).path)
        try:
            if path == "/":
                self._answer(HTTPStatus.OK, index_page(self.server.library), "text/html")
                return
            _, kind, name = path.split("/", 2)
            log = self.server.library.find(name)
            if log is None or kind not in ("run", "data"):
                raise ValueError(path)
            story = self.server.library.story(log)
        except ValueError:
            self._answer(HTTPStatus.NOT_FOUND, b"there is no such run here", "text/plain")
        except (LogError, OSError) as error:
            self._answer(HTTPStatus.UNPROCESSABLE_ENTITY, str(error).encode(), "text/plain")
        else:
            live = "" if story["finished"] else f"/data/{quote(name)}"
            if kind == "data":
                self._answer(HTTPStatus.OK, msgspec.json.encode(story), "application/json")
            else:
                self._answer(HTTPStatus.OK, render([story], live).encode(), "text/html")

    def log_message(self, format: str, *args: Any) -> None:  # the base class names it so
        """Nothing: requests of a reviewer are not worth a line."""

    def _answer(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)


def open_server(folder: Path, host: str, port: int) -> Server:
    """A server of `folder`, listening. Raises LogError where there is no folder, LinkError where the port is taken."""
    if not folder.is_dir():
        raise LogError(f"{folder} is no folder: name the one that holds the logs")
    try:
        return Server((host, port), Library(folder))
    except OSError as error:
        raise LinkError(f"cannot listen on {host}:{port}: {error.strerror}; take another with --port") from error


def index_page(library: Library) -> bytes:
    """The list of runs."""
    rows = "".join(_row(library, path) for path in library.logs())
    empty = "" if rows else f"<p>No logs in {html.escape(str(library.folder))} yet.</p>"
    style = asset("page.css") + _STYLE
    heads = "".join(f'<th scope="col">{head}</th>' for head in ("Run", "Team", "Allocator", "Seed", "MB", "State"))
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1"><title>gatar runs</title>'
        f"<style>{style}</style></head><body><main><h1>Missions</h1>{empty}"
        f'<div class="card"><table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div></main>'
        '<script>if (matchMedia("(prefers-color-scheme: dark)").matches)'
        ' document.documentElement.dataset.theme = "dark";</script></body></html>'
    ).encode()


def _row(library: Library, path: Path) -> str:
    name = str(path.relative_to(library.folder))
    size = f"{path.stat().st_size / 1e6:.1f}"
    link = f'<a href="/run/{quote(name)}">{html.escape(name)}</a>'
    try:
        run = run_of(LogReader(path, salvage=True).run_info())
    except LogError as error:
        reason = html.escape(str(error))
        return f'<tr><td>{html.escape(name)}</td><td colspan="3">{reason}</td><td>{size}</td><td></td></tr>'
    cells = [html.escape(str(run.get(key, ""))) for key in ("team", "allocator", "seed")]
    state = "complete" if _finished(path) else "open"
    return "<tr>" + "".join(f"<td>{cell}</td>" for cell in (link, *cells, size, state)) + "</tr>"


def _finished(path: Path) -> bool:
    """Whether the file ends in MCAP's magic: without reading what is before it."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 8))
        return file.read(8) == b"\x89MCAP0\r\n"
