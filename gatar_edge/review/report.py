"""The page of a mission: one HTML file that needs no network, and opens wherever it is sent."""

from __future__ import annotations

import base64
import gzip
import html
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import msgspec

from gatar_edge.review.reader import LogReader
from gatar_edge.review.story import read_story
from gatar_edge.review.whole import written_whole

MODULES = ("run", "map", "lanes", "charts", "panel", "app")


def write_report(log: Path, output: Path, compare: Path | None = None) -> Path:
    """Write the page of `log`, beside another mission's where `compare` is given. Raises LogError.

    An existing page is replaced only when the new one is complete.
    """
    sources = [path for path in (log, compare) if path is not None]
    page = render([read_story(LogReader(path)) for path in sources])
    with written_whole(output, sources) as stream:
        stream.write(page.encode())
    return output


def render(stories: Sequence[dict[str, Any]], live: str = "") -> str:
    """The page of one mission, or of two side by side; `live` is the address that it asks for news."""
    imports = {f"gatar/{name}": _data_url(asset(f"{name}.js")) for name in MODULES}
    blocks = "\n".join(
        f'<script type="application/gzip" data-run="{index}">{_packed(story)}</script>'
        for index, story in enumerate(stories)
    )
    parts = {
        "title": html.escape(f"gatar mission review: {stories[0]['name']}"),
        "css": asset("page.css"),
        "importmap": msgspec.json.encode({"imports": imports}).decode(),
        "live": html.escape(live, quote=True),
        "data": blocks,
    }
    page = asset("page.html")
    for name, text in parts.items():
        page = page.replace("{{" + name + "}}", text, 1)
    return page


def _packed(story: dict[str, Any]) -> str:
    # without a time stamp, so that the same log gives the same page
    return base64.b64encode(gzip.compress(msgspec.json.encode(story), 6, mtime=0)).decode()


def _data_url(source: str) -> str:
    return "data:text/javascript;base64," + base64.b64encode(source.encode()).decode()


def asset(name: str) -> str:
    """One of the page's sources."""
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
