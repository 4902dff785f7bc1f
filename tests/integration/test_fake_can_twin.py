"""A twin with a belt: what it serves, what it writes for the daemon, and its faults."""

import asyncio
import math
import tomllib
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from scipy.stats import theilslopes

from cell.clock import MonotonicClock
from cell.errors import CellError
from daemon.config.drivers import driver_class
from daemon.config.load import load_config
from fakes.twin.control import ask
from fakes.twin.serve import Twin, TwinOptions

pytestmark = pytest.mark.wire
HOST = "127.0.51.5"
SCENARIO = f"""
schema = "cellward.scenario/1"
[world]
[world.arm]
model = "ur10e"
q_start = [0.0, -1.8, 1.8, -1.57, -1.57, 0.0]
[world.belt]
serial = "999966042"
node = 7
m_per_count = 0.0002
modulus = 30000
profile = [{{ speed_m_s = 0.2 }}]
[fakes]
bind = "{HOST}"
can = "socketcand"
can_port = 29540
"""


def twin(folder: Path, script: Callable[[Twin], Awaitable[None]], text: str = SCENARIO) -> None:
    scenario = folder / "scenario.toml"
    scenario.write_text(text, "utf-8")

    async def scene() -> None:
        async with Twin(TwinOptions(str(scenario), folder / "twin")) as subject:
            await script(subject)

    asyncio.run(scene())


async def request(subject: Twin, what: dict[str, Any]) -> Any:
    return await asyncio.to_thread(ask, subject.folder, what)


@pytest.mark.parametrize("can", ["slcan", "socketcand"])
def test_a_daemon_finds_the_encoder_by_the_config_that_the_twin_writes(tmp_path: Path, can: str) -> None:
    async def script(subject: Twin) -> None:
        cell = tomllib.loads(subject.cell_toml.read_text("utf-8"))
        load_config(subject.cell_toml)
        assert cell["robot"]["belt"] == "belt"
        table = cell["device"]["belt"]
        assert table["bus"].startswith(f"{can}:")
        assert table["bus"] == subject.addresses()[f"encoder {can}"]
        assert table["expect_serial"] == "999966042"
        driver = driver_class(table.pop("driver"))
        device = driver("belt", driver.Config.model_validate(table), MonotonicClock())
        await device.open()
        try:
            await device.wait_fresh(2.0)
            assert (await device.identify()).serial == "999966042"
            assert device.modulus == 30000
            begin = device.counts.latest(1.0).t
            before = (await request(subject, {"do": "truth"}))["belt"]["travel_m"]
            await asyncio.sleep(0.3)
            samples = device.counts.between(begin, math.inf)
            after = (await request(subject, {"do": "truth"}))["belt"]["travel_m"]
            travel, t = [0.0002 * s.value.count for s in samples], [s.t for s in samples]
            # the median of all slopes: counts of a pause of this process are stamped when it ends
            assert theilslopes(travel, t).slope == pytest.approx(0.2, rel=0.03)
            assert after - before > 0.05
            await request(
                subject, {"do": "fault", "device": "belt", "kind": "unplug", "args": {"for_s": 0.5}}
            )
            async with asyncio.timeout(3.0):
                assert (await device.wait_lost()).name == "DEVICE_LOST"
        finally:
            await device.close()

    twin(tmp_path, script, SCENARIO.replace('can = "socketcand"', f'can = "{can}"'))
    assert not (tmp_path / "twin" / "can.tty").is_symlink()


def test_faults_of_the_belt_are_taken_from_the_control_socket_and_checked(tmp_path: Path) -> None:
    async def script(subject: Twin) -> None:
        def fault(kind: str, **arguments: Any) -> Awaitable[Any]:
            return request(subject, {"do": "fault", "device": "belt", "kind": kind, "args": arguments})

        await fault("belt-stop", accel=10.0)
        await asyncio.sleep(0.1)
        assert (await request(subject, {"do": "truth"}))["belt"]["speed_m_s"] == 0.0
        await fault("clear")
        await asyncio.sleep(0.1)
        assert (await request(subject, {"do": "truth"}))["belt"]["speed_m_s"] > 0.0
        for kind, arguments, said in (
            ("slip", {"m": 3.0}, "a metre at most"),
            ("reboot", {"serial": "99996600001"}, "32 bits"),
            ("alarm", {"code": 70000}, "16 bits"),
            ("dark", {}, "belt has no fault 'dark'"),
            ("unplug", {"meters": 1}, "does not take meters"),
        ):
            with pytest.raises(CellError, match=said):
                await fault(kind, **arguments)

    twin(tmp_path, script)
