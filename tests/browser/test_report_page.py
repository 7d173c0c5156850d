"""The page in a real browser: it plays, scrubs, follows, explains, and says nothing on the console."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from missions import record_mission

from gatar_edge.allocators.nearest import Nearest
from gatar_edge.allocators.routing import RoutingWithMemory
from gatar_edge.review.report import write_report
from gatar_edge.review.serve import open_server

pytestmark = pytest.mark.browser

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
)  # fmt: skip


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    if CHROMIUM is None or DRIVER is None:
        pytest.skip("no chromium and chromedriver here: apt-get install chromium chromium-driver")
    webdriver = pytest.importorskip("selenium.webdriver")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}", "--window-size=1400,1000"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(executable_path=DRIVER))
    driver.set_script_timeout(20)
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("pages")
    record_mission(folder / "a.mcap")
    record_mission(folder / "b.mcap", Nearest)
    return {
        "one": write_report(folder / "a.mcap", folder / "one.html"),
        "two": write_report(folder / "a.mcap", folder / "two.html", folder / "b.mcap"),
    }


class Page:
    """One opened page."""

    def __init__(self, browser: Any, path: Path, moment: str = "#t=0") -> None:
        browser.get("about:blank")
        browser.get(f"{path.as_uri()}{moment}")
        self._open(browser)

    @classmethod
    def of(cls, browser: Any) -> Page:
        """The page that the browser shows."""
        page = cls.__new__(cls)
        page._open(browser)
        return page

    def _open(self, browser: Any) -> None:
        self.browser = browser
        self.until("document.body.dataset.ready")
        self.frames(2)

    def js(self, expression: str) -> Any:
        """The value of an expression in the page."""
        return self.browser.execute_script(f"return ({expression});")

    def frames(self, count: int) -> None:
        """Let the page draw."""
        self.browser.execute_async_script(
            "const done = arguments[1]; let n = arguments[0];"
            "const next = () => (n-- ? requestAnimationFrame(next) : done()); next();",
            count,
        )

    def until(self, condition: str) -> None:
        """Draw until a condition holds, or fail."""
        met = self.browser.execute_async_script(
            "const [condition, done] = arguments; let n = 600;"
            "const look = () => (eval(condition) ? done(true) : n-- ? requestAnimationFrame(look) : done(false));"
            "look();",
            condition,
        )
        assert met, f"never: {condition}"

    def press(self, *keys: str) -> None:
        """Press keys."""
        from selenium.webdriver.common.action_chains import ActionChains

        for key in keys:
            ActionChains(self.browser).send_keys(key).perform()
        self.frames(2)

    def click(self, selector: str) -> None:
        """Click the first element."""
        self.browser.execute_script(
            "const e = document.querySelector(arguments[0]); e.scrollIntoView({block: 'center'}); e.click();", selector
        )
        self.frames(2)

    def text(self, selector: str) -> str:
        """The text of the first element."""
        return str(self.js(f"document.querySelector({selector!r}).innerText"))

    def ink(self, selector: str) -> int:
        """How many pixels of a canvas are painted."""
        return int(
            self.js(
                f"(() => {{ const c = document.querySelector({selector!r});"
                "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
                "let n = 0; for (let i = 3; i < d.length; i += 4) n += d[i] > 0; return n; })()"
            )
        )

    def errors(self) -> list[str]:
        """What the console holds against the page."""
        return [entry["message"] for entry in self.browser.get_log("browser") if entry["level"] != "INFO"]


@pytest.fixture
def page(browser: Any, pages: dict[str, Path]) -> Iterator[Page]:
    opened = Page(browser, pages["one"])
    yield opened
    assert opened.errors() == []


def test_it_plays_and_the_robots_move(page: Page) -> None:
    before = page.js("gatar.place(1)")
    page.press(" ")
    assert page.js("gatar.state.playing")
    page.until("gatar.state.t > 2500")
    page.press(" ")
    assert not page.js("gatar.state.playing")
    now = page.js("gatar.place(1)")
    assert (before["x"], before["y"]) != (now["x"], now["y"])
    assert page.text("#clock").startswith(f"{page.js('gatar.state.t') / 1000:.1f}"[:2])


def test_between_two_steps_robots_are_between_two_cells(page: Page) -> None:
    moving = page.js(
        "gatar.runs[0].robots.map((r) => gatar.runs[0].place(r, 1500)).filter((p) => p.x % 1 || p.y % 1).length"
    )
    assert moving > 0


def test_it_draws_a_map_lanes_and_charts(page: Page) -> None:
    assert page.ink(".map canvas") > 100_000
    assert page.ink(".lanes canvas") > 3_000
    assert page.js("document.querySelectorAll('.chart path').length") >= 6


def test_it_scrubs(page: Page) -> None:
    page.js("(() => { const s = document.getElementById('scrub'); s.value = 4000; s.oninput(); })()")
    page.frames(2)
    assert page.text("#clock").startswith("4.0 s")
    assert page.js("document.getElementById('scrub').getAttribute('aria-valuetext')").startswith("4.0 s of ")


def test_arrows_step_and_home_and_end_jump(page: Page) -> None:
    from selenium.webdriver.common.keys import Keys

    page.press(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_LEFT)
    assert page.js("gatar.state.t") == 2000
    page.press(Keys.END)
    assert page.js("gatar.state.t") == page.js("gatar.runs[0].duration")
    found = page.js("gatar.runs[0].visits.length")
    assert page.text("#count") == f"{found} of {page.js('gatar.runs[0].reachable')}"
    page.press(Keys.HOME)
    assert page.js("gatar.state.t") == 0


def test_a_number_follows_a_robot_and_says_why_it_does_what_it_does(page: Page) -> None:
    page.press("3")
    assert page.js("gatar.state.follow") == 3
    assert page.js("document.querySelector('#robots [data-id=\"3\"]').getAttribute('aria-pressed')") == "true"
    assert page.text("#why").startswith("Why UGV 3 does this")
    assert "Robots it had heard" in page.text("#why") or "heard nobody" in page.text("#why")
    page.press("0")
    assert page.js("gatar.state.follow") == 0


def test_the_map_of_a_followed_robot_shows_what_it_alone_knows(page: Page) -> None:
    known = "[...gatar.runs[0].{}].filter((row) => row[0] <= 0).flatMap((row) => row.slice(1)).length"
    assert page.js(known.format("robots[0].belief")) < page.js(known.format("teamBelief"))


def test_a_followed_robots_map_and_words_show_whom_it_remembers(browser: Any, tmp_path: Path) -> None:
    record_mission(tmp_path / "a.mcap", RoutingWithMemory, team="2A1G", size=20)
    page = Page(browser, write_report(tmp_path / "a.mcap", tmp_path / "a.html"))
    assert "out of range" in page.text(".map figcaption")
    index = page.js("gatar.runs[0].events.findIndex((event) => event.absent.length)")
    page.click(f"#decisions [data-index='{index}']")
    assert "Out of range, reckoned with" in page.text("#decisions tr.detail")
    robot = "gatar.runs[0].byId.get(gatar.state.follow)"
    assert page.js(f"gatar.runs[0].absent({robot}, gatar.state.t).length") > 0
    shown = page.js("document.querySelector('.map canvas').toDataURL()")
    page.js(f"{robot}.absent = []")
    page.js("gatar.seek(gatar.state.t)")
    page.frames(2)
    assert page.js("document.querySelector('.map canvas').toDataURL()") != shown
    assert page.errors() == []


def test_a_click_on_a_decision_explains_it(page: Page) -> None:
    rows = page.js("document.querySelectorAll('#decisions tr.row').length")
    assert rows == page.js("gatar.runs[0].events.length")
    page.click("#decisions tr.row:nth-child(5) button")
    detail = page.text("#decisions tr.detail")
    assert page.js("gatar.runs[0].events[4].head") in detail
    assert page.js("gatar.state.t") == page.js("gatar.runs[0].events[4].t")
    assert page.js("gatar.state.follow") == page.js("gatar.runs[0].events[4].id")
    page.click("#decisions tr.row:nth-child(5) button")
    assert page.js("document.querySelectorAll('#decisions tr.detail').length") == 0


def test_decisions_can_be_filtered(page: Page) -> None:
    page.js("(() => { const f = document.getElementById('filter-robot'); f.value = '2'; f.onchange(); })()")
    robots = page.js("[...document.querySelectorAll('#decisions tr.row td:nth-child(2)')].map((e) => e.innerText)")
    assert set(robots) == {"UAV 2"}


def test_what_is_chosen_is_said_to_screen_readers(page: Page) -> None:
    page.press("2")
    said = page.text("#live")
    assert "targets localized" in said
    assert "UAV 2" in said
    assert said in page.js("document.querySelector('.map canvas').getAttribute('aria-label')")


def test_light_and_dark_differ(page: Page) -> None:
    look = "getComputedStyle(document.body).backgroundColor"
    first = page.js(look)
    page.press("d")
    assert page.js(look) != first
    page.press("d")
    assert page.js(look) == first


def test_an_address_points_at_a_moment_and_a_robot(browser: Any, pages: dict[str, Path]) -> None:
    page = Page(browser, pages["one"], "#t=3.5&robot=4")
    assert (page.js("gatar.state.t"), page.js("gatar.state.follow")) == (3500, 4)
    assert not page.js("gatar.state.playing")
    assert page.errors() == []


def test_two_missions_play_side_by_side(browser: Any, pages: dict[str, Path]) -> None:
    page = Page(browser, pages["two"], "#t=2")
    assert page.js("document.querySelectorAll('.map canvas').length") == 2
    assert page.ink(".map:nth-child(2) canvas") > 50_000
    assert "B:" in page.text("#tiles")
    assert page.text("h1").startswith("A: ")
    assert page.errors() == []


def test_on_a_phone_nothing_is_wider_than_the_screen(browser: Any, pages: dict[str, Path]) -> None:
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    )
    try:
        page = Page(browser, pages["one"], "#t=2")
        assert page.js("document.documentElement.scrollWidth") <= 390
        assert page.ink(".map canvas") > 100_000
        assert page.errors() == []
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_the_page_asks_the_network_for_nothing(pages: dict[str, Path]) -> None:
    text = pages["one"].read_text(encoding="utf-8")
    assert "http://" not in text.replace("http://www.w3.org/", "")
    assert "https://" not in text
    assert "{{" not in text


def test_a_mission_that_is_being_recorded_grows_on_the_page(browser: Any, tmp_path: Path) -> None:
    mission = record_mission(tmp_path / "flying.mcap", steps=3, close=False)
    server = open_server(tmp_path, "127.0.0.1", 0)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        browser.get(f"http://127.0.0.1:{server.server_port}/run/flying.mcap")
        page = Page.of(browser)
        assert page.js("gatar.runs[0].duration") == 3000
        mission.fly(4)
        page.js("gatar.refresh()")
        page.until("gatar.runs[0].duration >= 6000")
        assert page.js("gatar.state.t") == page.js("gatar.runs[0].duration")
        assert page.errors() == []
    finally:
        browser.get("about:blank")
        server.shutdown()
        server.server_close()
        thread.join()
        assert mission.recorder is not None
        mission.recorder.close()
