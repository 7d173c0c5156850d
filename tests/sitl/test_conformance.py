"""The bridge on any autopilot: real where GATAR_SITL_COPTER, _ROVER, _PX4 or _PX4_ROVER hold URLs, else simulated.

See docs/conformance.md. On a real one a test begins with the vehicle as the test before left it: no test relies on it
standing at home, only on it being where a grid of 75 m round it is free.
"""

from __future__ import annotations

import os
import random
from collections.abc import Iterator

import pytest
from conformance import SUBJECTS, Bench, Subject, bench_of

from gatar_edge.bridge.driver import VehicleDriver
from gatar_edge.bridge.geo import cell_to_wgs84
from gatar_edge.bridge.link import Link
from gatar_edge.bridge.mission_items import build, same_mission
from gatar_edge.bridge.mission_states import Result
from gatar_edge.bridge.mission_transfer import MissionClient
from gatar_edge.bridge.status import Status
from gatar_edge.types import Cell, Goto, Hold, Mission, VehicleCommand

LAUNCH_S = 150.0  # an EKF takes 45 s, a climb to 10 m a few more
LEG_S = 90.0


@pytest.fixture(params=SUBJECTS, ids=lambda subject: subject.name)
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    subject: Subject = request.param
    links: list[Link] = []
    try:
        yield bench_of(subject, links)
    finally:
        for link in links:
            link.close()


def launched(bench: Bench, **config: object) -> VehicleDriver:
    driver = bench.driver(**config)
    ready = bench.run(lambda: driver.state(bench.now_ns).ready, LAUNCH_S)
    events = [event.text for event in driver.events()]
    assert ready, f"{driver.state(bench.now_ns)}, {events}"
    return driver


def way(bench: Bench, *cells: Cell) -> VehicleCommand:
    """As the allocator would want it: a UAV flies straight, a UGV drives along the corners."""
    return Goto(cells[-1]) if bench.flies else Mission(cells)


def pursue(bench: Bench, driver: VehicleDriver, command: VehicleCommand, goal: Cell) -> None:
    def there() -> bool:
        driver.command(command, bench.now_ns)
        return driver.state(bench.now_ns).cell == goal and driver.status is Status.ARRIVED

    assert bench.run(there, LEG_S), f"{driver.status}, {driver.state(bench.now_ns)}"


def client_of(bench: Bench) -> MissionClient:
    client = MissionClient(bench.profile, (bench.sysid, 191), (bench.sysid, 1), random.Random(1))

    def hear(frame: object) -> None:
        client.receive(frame.source, frame.message, bench.now_ns)  # type: ignore[attr-defined]

    bench.talk(hear, lambda: client.poll(bench.now_ns))
    return client


def ended(bench: Bench, client: MissionClient) -> Result | None:
    bench.run(lambda: client.result is not None, 65)
    return client.result


def test_the_vehicle_is_recognized_and_told_where_it_is(bench: Bench) -> None:
    driver = bench.driver(auto_launch=False)
    assert bench.run(lambda: driver.state(bench.now_ns).cell is not None, 30)
    state = driver.state(bench.now_ns)
    assert state.connected
    assert state.details["profile"] == bench.profile.name


def test_a_mission_goes_up_and_comes_down_the_same(bench: Bench) -> None:
    client = client_of(bench)
    points = tuple(cell_to_wgs84(bench.grid, cell) for cell in ((7, 8), (8, 8), (8, 6), (6, 6), (6, 7)))
    items = build(bench.profile, points, 10.0 if bench.flies else 0.0)
    client.upload(items, bench.now_ns)
    assert ended(bench, client) is Result.ACCEPTED
    client.upload(items, bench.now_ns)
    assert client.result is Result.ALREADY_ON_BOARD
    client.download(bench.now_ns)
    assert ended(bench, client) is Result.DOWNLOADED
    assert same_mission(items, client.downloaded, bench.profile)


def test_a_shorter_mission_leaves_nothing_of_the_longer_one(bench: Bench) -> None:
    client = client_of(bench)
    for count in (9, 2):
        points = tuple(cell_to_wgs84(bench.grid, (7, n)) for n in range(count))
        client.upload(build(bench.profile, points, 10.0), bench.now_ns)
        assert ended(bench, client) is Result.ACCEPTED
    client.download(bench.now_ns)
    assert ended(bench, client) is Result.DOWNLOADED
    assert len(client.downloaded) == 2 + bench.profile.first_item_seq


def test_the_vehicle_is_launched_goes_where_it_is_told_and_is_retasked_on_the_way(bench: Bench) -> None:
    driver = launched(bench)
    first, second = (9, 9), (5, 10)
    outward = way(bench, (9, 7), first)
    for _ in range(80):  # four seconds on its way
        driver.command(outward, bench.now_ns)
        bench.step()
    here = driver.state(bench.now_ns).cell
    assert here is not None
    pursue(bench, driver, way(bench, (here[0], 10), second), second)


def test_a_vehicle_that_has_arrived_takes_its_next_task(bench: Bench) -> None:
    driver = launched(bench)
    pursue(bench, driver, way(bench, (7, 9)), (7, 9))
    pursue(bench, driver, way(bench, (7, 7), (8, 7)), (8, 7))


@pytest.mark.parametrize("targets", ["reposition", "setpoint"])
def test_a_vehicle_goes_by_guided_targets_however_they_are_given(bench: Bench, targets: str) -> None:
    if targets == "setpoint" and bench.profile.position_frame is None:
        pytest.skip(f"{bench.profile.name} would need a stream of them")
    driver = launched(bench, drive="guided", targets=targets)
    pursue(bench, driver, way(bench, (7, 9)), (7, 9))
    pursue(bench, driver, way(bench, (7, 7), (8, 7)), (8, 7))


def test_a_hold_stops_the_vehicle_on_its_way(bench: Bench) -> None:
    driver = launched(bench)
    far = (7, 14)

    def under_way() -> bool:
        driver.command(way(bench, far), bench.now_ns)
        cell = driver.state(bench.now_ns).cell
        return cell is not None and cell[1] > 7

    assert bench.run(under_way, 30), driver.status

    def stopped() -> bool:
        driver.command(Hold("enough"), bench.now_ns)
        return driver.status is Status.HOLDING and driver.state(bench.now_ns).speed_m_s < 0.3

    assert bench.run(stopped, 20), driver.status
    assert driver.state(bench.now_ns).cell != far


def test_a_real_autopilot_of_another_kind_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    if any(subject.variable in os.environ for subject in SUBJECTS):
        pytest.skip("tested with the simulated vehicles alone")
    from gatar_edge.sim_sitl.served import ServedVehicles

    with ServedVehicles([SUBJECTS[0].simulated], speed=5.0) as served:
        monkeypatch.setenv("GATAR_SITL_ROVER", served.url)
        links: list[Link] = []
        try:
            with pytest.raises(pytest.fail.Exception, match="leads to ardupilot-copter"):
                bench_of(SUBJECTS[1], links)
        finally:
            for link in links:
                link.close()
