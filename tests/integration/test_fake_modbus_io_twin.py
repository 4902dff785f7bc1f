"""A twin with an input module and without a camera: what it serves, what it writes, what it refuses."""

import asyncio
import time
import tomllib
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import psutil
import pytest

from cell.errors import CellError
from drivers.modbus_inputs.config import InputsConfig
from fakes.twin.control import ask
from fakes.twin.serve import Twin, TwinOptions
from fakes.wire.ticker import Ticker
from tests.kit.modbus_io_rig import RawClient

pytestmark = pytest.mark.wire
HOST = "127.0.22.2"
SCENARIO = f"""
schema = "cellward.scenario/1"
[world]
[world.arm]
model = "ur10e"
q_start = [0.0, -1.8, 1.8, -1.57, -1.57, 0.0]
[world.beams.xs]
point = [0.0, 5.0, 0.2]
dir = [1.0, 0.0, 0.0]
[world.beams.ys]
point = [0.0, 5.0, 0.2]
dir = [0.0, 1.0, 0.0]
[world.io]
module = "ioLogik-E1210"
serial = "99993300042"
inputs = {{ xs = 3, ys = 4 }}
inverted = ["ys"]
counters = true
[fakes]
bind = "{HOST}"
io_port = 5513
io_rtu = true
"""


def twin(folder: Path, script: Callable[[Twin], Awaitable[None]], text: str = SCENARIO) -> None:
    scenario = folder / "scenario.toml"
    scenario.write_text(text, "utf-8")

    async def scene() -> None:
        async with Twin(TwinOptions(str(scenario), folder / "twin")) as subject:
            await script(subject)

    asyncio.run(scene())


def test_the_module_listens_where_the_config_of_the_daemon_says(tmp_path: Path) -> None:
    async def script(subject: Twin) -> None:
        cell = tomllib.loads(subject.cell_toml.read_text("utf-8"))
        beams = cell["device"]["beams"]
        assert cell["robot"]["beams"] == "beams"
        assert beams == {
            "driver": "modbus-inputs",
            "url": f"tcp://{HOST}:5513",
            "module": "ioLogik-E1210",
            "poll_period_s": 0.005,
            "filter_s": 0.0,
            "inputs": {"xs": {"address": 3, "invert": False}, "ys": {"address": 4, "invert": True}},
            "expect_serial": "99993300042",
        }
        assert subject.addresses()["inputs"] == beams["url"]
        line = subject.folder / "io.tty"
        assert subject.addresses()["inputs serial"].startswith(f"rtu://{line}")
        assert line.resolve().is_char_device()
        async with await RawClient.open((HOST, 5513)) as client:
            assert await client.ask("0400300001") == "04020010", (
                "only the inverted input of a free beam is on"
            )
            assert (await client.ask("2b0e0480")).endswith(b"99993300042".hex())

    twin(tmp_path, script)
    assert not (tmp_path / "twin" / "io.tty").is_symlink()


@pytest.mark.parametrize(
    ("module", "counters", "said"),
    [
        ("generic", "true", {"counters": {"table": "input", "address": 0}}),
        ("generic", "false", {}),
        ("ADAM-6050", "true", {}),
        ("ADAM-6050", "false", {"use_counters": False}),
    ],
)
def test_the_config_says_whether_there_are_counters_and_the_driver_takes_it(
    tmp_path: Path, module: str, counters: str, said: dict[str, Any]
) -> None:
    text = SCENARIO.replace("ioLogik-E1210", module).replace("counters = true", f"counters = {counters}")

    async def script(subject: Twin) -> None:
        beams = tomllib.loads(subject.cell_toml.read_text("utf-8"))["device"]["beams"]
        assert {key: beams[key] for key in beams if "counters" in key} == said
        model = InputsConfig.model_validate({k: v for k, v in beams.items() if k != "driver"}).model
        assert (model.counters is not None) == (counters == "true")

    twin(tmp_path, script, text)


def test_without_a_camera_there_is_no_camera_process_and_no_target_to_move(tmp_path: Path) -> None:
    # multiprocessing keeps one tracker process for the life of the interpreter.
    before = {child.pid for child in psutil.Process().children()}

    async def script(subject: Twin) -> None:
        assert {child.pid for child in psutil.Process().children()} <= before
        cell = tomllib.loads(subject.cell_toml.read_text("utf-8"))
        assert "camera" not in cell["device"]
        assert not any("camera" in name for name in subject.addresses())
        with pytest.raises(CellError, match="no target"):
            await request(subject, {"do": "operator", "next": True})
        with pytest.raises(CellError, match="no device 'camera'; there are arm, beams"):
            await request(subject, {"do": "fault", "device": "camera", "kind": "dark", "args": {}})

    twin(tmp_path, script)


async def request(subject: Twin, what: dict[str, Any]) -> Any:
    return await asyncio.to_thread(ask, subject.folder, what)


def test_faults_of_the_module_come_from_the_control_socket_and_from_the_scenario(tmp_path: Path) -> None:
    fault = '[[fault]]\ndevice = "beams"\nkind = "silence"\nwhen_s = 0.0\n'

    async def script(subject: Twin) -> None:
        async with await RawClient.open((HOST, 5513)) as client:
            await asyncio.sleep(0.01)
            client.put("0400300001")
            assert await client.silent()
            what = {"do": "fault", "device": "beams", "kind": "clear", "args": {}}
            await request(subject, what)
            assert await client.ask("0400300001") == "04020010"
            await request(
                subject, {**what, "kind": "reboot", "args": {"boot_s": 30, "serial": "99993300043"}}
            )
            assert await client.ended() == "RST"

    twin(tmp_path, script, SCENARIO + fault)


def test_faults_of_the_inputs_show_in_the_registers(tmp_path: Path) -> None:
    async def script(subject: Twin) -> None:
        async def fault(kind: str, **args: Any) -> None:
            await request(subject, {"do": "fault", "device": "beams", "kind": kind, "args": args})

        async with await RawClient.open((HOST, 5513)) as client:
            await fault("wrap", before=1)
            assert await client.ask("0400160002") == "0404ffffffff"
            await fault("stuck", input="xs", level="on")
            assert await client.ask("0400300001") == "04020018"
            assert await client.ask("0400160002") == "040400000000", "the edge took it over its end"
            await fault("clear")
            assert await client.ask("0400300001") == "04020010"
            with pytest.raises(CellError, match="'zs' is not an input; there are xs, ys"):
                await fault("stuck", input="zs")

    twin(tmp_path, script)


def test_a_fault_of_a_device_that_the_scenario_has_not_is_said_at_the_start(tmp_path: Path) -> None:
    fault = '[[fault]]\ndevice = "camera"\nkind = "dark"\nwhen_s = 0.0\n'
    with pytest.raises(CellError, match="names camera, which the scenario has not") as caught:
        twin(tmp_path, lambda subject: asyncio.sleep(0), SCENARIO + fault)
    assert caught.value.name == "CONFIG_INVALID"


def test_an_address_of_the_module_that_is_taken_is_said_in_one_sentence(tmp_path: Path) -> None:
    async def script(subject: Twin) -> None:
        other = SCENARIO.replace(f'bind = "{HOST}"', 'bind = "127.0.22.3"')
        taken = await asyncio.start_server(lambda r, w: None, "127.0.22.3", 5513)
        (tmp_path / "other.toml").write_text(other, "utf-8")
        try:
            with pytest.raises(CellError, match=r"cannot listen on 127\.0\.22\.3") as caught:
                async with Twin(TwinOptions(str(tmp_path / "other.toml"), tmp_path / "other")):
                    pass
            assert caught.value.name == "DEVICE_UNREACHABLE"
        finally:
            taken.close()

    twin(tmp_path, script)


def test_the_control_cycles_of_the_past_are_done_before_an_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Or what they do would change what was answered, when the loop comes to the question first."""
    due_by_then: list[int] = []
    real = Ticker.catch_up

    def noted(ticker: Ticker) -> float:
        now = real(ticker)
        due_by_then.append(ticker.cycles)
        return now

    monkeypatch.setattr(Ticker, "catch_up", noted)

    async def script(subject: Twin) -> None:
        async with await RawClient.open((HOST, 5513)) as client:
            await client.ask("0400300001")
            due_by_then.clear()
            before = subject.controller.ticker.cycles
            client.put("0400300001")
            until = time.monotonic() + 0.05
            while time.monotonic() < until:  # the loop gets no core
                pass
            await client.reply()
            assert due_by_then[0] - before >= 20

    twin(tmp_path, script)


def test_the_place_is_served_as_an_input_that_a_user_can_block(tmp_path: Path) -> None:
    text = f"""
schema = "cellward.scenario/1"
[world.arm]
model = "ur10e"
q_start = [0.0, -1.8, 1.8, -1.57, -1.57, 0.0]
[world.gripper]
[world.place]
input = "free"
carried_off_s = 0.4
[fakes]
bind = "{HOST}"
place_port = 5514
"""

    async def script(subject: Twin) -> None:
        cell = tomllib.loads(subject.cell_toml.read_text("utf-8"))
        assert cell["robot"]["place_inputs"] == "place_inputs"
        section = InputsConfig.model_validate(
            {k: v for k, v in cell["device"]["place_inputs"].items() if k != "driver"}
        )
        assert section.inputs["free"].address == 0
        async with await RawClient.open((HOST, 5514)) as client:
            assert await client.ask("0200000001") == "020101"
            carried_off_s = await asyncio.to_thread(ask, subject.folder, {"do": "operator", "block": True})
            assert await client.ask("0200000001") == "020100"
            await asyncio.sleep(carried_off_s + 0.1)
            assert await client.ask("0200000001") == "020101"

    twin(tmp_path, script, text)
