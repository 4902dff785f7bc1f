"""A twin with a laser tracker: what it serves and writes, what its lines say, what an operator can do."""

import asyncio
import tomllib
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import CellError
from daemon.config import load_config
from fakes.twin.control import ask
from fakes.twin.serve import Twin, TwinOptions
from fakes.world.scenario import Scenario

pytestmark = pytest.mark.wire
HOST = "127.0.42.3"
LINES = """
[fakes.tracker_lines]
port = 5013
text = "P{n};{x:.5f};{y:.5f};{z:.5f};{valid}\\r\\n"
heading = "# x y z in mm\\r\\n"
reflector = "m1"
period_s = 0.02
relock_s = 0.1
"""


def twin(folder: Path, script: Callable[[Twin], Awaitable[None]], more: str = "") -> None:
    shipped = Path(__file__).parents[2] / "fakes" / "scenarios" / "tracker.toml"
    scenario = folder / "scenario.toml"
    scenario.write_text(shipped.read_text("utf-8").replace('bind = "127.0.0.2"', f'bind = "{HOST}"') + more)

    async def scene() -> None:
        async with Twin(TwinOptions(str(scenario), folder / "twin")) as subject:
            await script(subject)

    asyncio.run(scene())


async def request(subject: Twin, what: dict[str, Any]) -> Any:
    return await asyncio.to_thread(ask, subject.folder, what)


def true_point(subject: Twin, name: str) -> np.ndarray[Any, Any]:
    tracker = subject.world.tracker
    assert tracker is not None
    return tracker.visibility.local(name, subject.controller.now())


async def point_of(reader: asyncio.StreamReader) -> tuple[np.ndarray[Any, Any], str]:
    async with asyncio.timeout(2.0):
        number, x, y, z, valid = (await reader.readline()).decode().strip().split(";")
    assert number.startswith("P")
    return np.array([float(x), float(y), float(z)]) / 1e3, valid


def test_the_config_names_the_wire_that_the_twin_serves_and_a_daemon_takes_it(tmp_path: Path) -> None:
    async def script(subject: Twin) -> None:
        section = tomllib.loads(subject.cell_toml.read_text("utf-8"))["device"]["tracker"]
        assert section["driver"] == "geocom"
        assert section["url"] == f"tcp://{HOST}:1212" == subject.addresses()["tracker"]
        assert section["expect_serial"] == "99994400001"
        assert set(section["reflectors"]) == {"smr1", "smr2", "m1", "m2", "m3", "m4"}
        line = subject.folder / "tracker.tty"
        assert subject.addresses()["tracker serial"] == f"serial://{line}?baudrate=115200"
        assert line.resolve().is_char_device()
        config = await asyncio.to_thread(load_config, subject.cell_toml)
        assert config.robot.tracker == "tracker"
        reader, writer = await asyncio.open_connection(HOST, 1212)
        writer.write(b"\n%R1Q,5003,1:\r\n")
        assert await reader.readline() == b"%R1P,0,1:0,99994400001\r\n"
        writer.close()

    twin(tmp_path, script)
    assert not (tmp_path / "twin" / "tracker.tty").is_symlink()


def test_the_truth_and_the_faults_are_at_the_control_socket(tmp_path: Path) -> None:
    async def script(subject: Twin) -> None:
        offered = (await request(subject, {"do": "faults"}))["tracker"]
        assert {"beam-break", "stand-moved", "return-code", "drop", "silence"} <= set(offered)
        fault = {"do": "fault", "device": "tracker", "kind": "stand-moved", "args": {"dx": 0.002}}
        before = (await request(subject, {"do": "truth"}))["tracker"]["T_base_tracker"]
        await request(subject, fault)
        after = (await request(subject, {"do": "truth"}))["tracker"]["T_base_tracker"]
        assert np.array(after) - before == pytest.approx([0.002, 0, 0, 0, 0, 0], abs=1e-12)

    twin(tmp_path, script)


def test_lines_tell_the_locked_point_until_the_beam_breaks_and_again_when_it_is_free(tmp_path: Path) -> None:
    async def script(subject: Twin) -> None:
        assert subject.addresses()["tracker lines"] == f"tcp://{HOST}:5013"
        reader, writer = await asyncio.open_connection(HOST, 5013)
        assert await reader.readline() == b"# x y z in mm\r\n"
        point, valid = await point_of(reader)
        assert valid == "1"
        assert point == pytest.approx(true_point(subject, "m1"), abs=3e-4)
        await request(subject, {"do": "tracker", "lock": "smr1"})
        for _ in range(100):
            point, valid = await point_of(reader)
            if np.linalg.norm(point - true_point(subject, "smr1")) < 3e-4:
                break
        else:
            pytest.fail("the lines never told of smr1")
        subject.switchboard.inject("tracker", "beam-break", {"for_s": 0.3})
        told = [(await point_of(reader))[1] for _ in range(60)]
        assert "0" in told
        assert told[-1] == "1"
        writer.close()

    twin(tmp_path, script, LINES)


def test_a_line_can_be_asked_for(tmp_path: Path) -> None:
    async def script(subject: Twin) -> None:
        reader, writer = await asyncio.open_connection(HOST, 5013)
        assert await reader.readline() == b"# x y z in mm\r\n"
        writer.write(b"GE")
        await asyncio.sleep(0.05)
        writer.write(b"T\nGET\n")
        numbers = [(await reader.readline()).split(b";")[0] for _ in range(2)]
        assert numbers == [b"P1", b"P2"]
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1):
                await reader.readline()
        subject.switchboard.inject("tracker", "drop", {})
        assert await reader.read() == b""
        writer.close()

    twin(tmp_path, script, LINES + 'request = "GET\\n"\n')


def test_an_operator_is_told_what_cannot_be_locked(tmp_path: Path) -> None:
    async def script(subject: Twin) -> None:
        with pytest.raises(CellError, match="there are smr1, smr2"):
            await request(subject, {"do": "tracker", "lock": "smr7"})
        subject.switchboard.inject("tracker", "beam-break", {"reflector": "smr1"})
        with pytest.raises(CellError, match="cannot lock smr1"):
            await request(subject, {"do": "tracker", "lock": "smr1"})

    twin(tmp_path, script)


def test_a_form_that_cannot_be_written_is_refused() -> None:
    text = Path(__file__).parents[2].joinpath("fakes/scenarios/tracker.toml").read_text("utf-8") + LINES
    with pytest.raises(CellError, match="text cannot be formatted"):
        Scenario.parse(text.replace("{valid}", "{validity}"))
