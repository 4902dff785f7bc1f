"""``time_offset_s`` has one sign for every driver: it is subtracted from the stamps."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import numpy as np
import pytest

from daemon.config import load_config
from daemon.config.drivers import DRIVERS, driver_class
from drivers.can_encoder.config import RawCanEncoderConfig
from drivers.can_encoder.raw import RawCanEncoder
from drivers.modbus_inputs.config import InputsConfig
from drivers.modbus_inputs.inputs import ModbusInputs
from drivers.modbus_inputs.plan import Reading as InputsReading
from drivers.oak.child import VisionChild
from drivers.observed_arm.config import ObservedArmConfig
from drivers.observed_arm.file import FileSource
from drivers.observed_arm.registers import RegisterSource
from drivers.tracker.geocom import GeocomTracker
from drivers.tracker.geocom_config import GeocomConfig
from drivers.tracker.line_config import LineStreamConfig
from drivers.tracker.line_points import LinePointConfig, LinePointTracker
from drivers.tracker.line_stream import LineStreamTracker
from tests.unit.drivers.test_ur_feed import Rig

NOW = 100.0


class Still:
    """A clock that stands."""

    def now(self) -> float:
        return NOW

    async def sleep(self, seconds: float) -> None:
        raise AssertionError("nothing here waits")


def arm(offset_s: float, folder: Path) -> float:
    rig = Rig(offset=offset_s)
    rig.take(1.0)
    return rig.stream.latest(1.0).t


def camera(offset_s: float, folder: Path) -> float:
    sent: list[dict[str, Any]] = []
    child: Any = VisionChild.__new__(VisionChild)
    child._link = SimpleNamespace(send=sent.append)
    child._detector, child._finder_for, child._captures = None, None, []
    child._items = lambda shot: None
    shot = SimpleNamespace(
        colour=np.zeros((4, 4, 3), np.uint8), seq=1, t_exposure=NOW, exposure_s=0.01, row_time_s=0.0,
        intrinsics=SimpleNamespace(width=4, height=4, K=(1.0, 1.0, 2.0, 2.0), dist=()),
    )  # fmt: skip
    child._look(shot, "1", offset_s)
    return float(sent[0]["frame"]["t_exposure"])


def inputs(offset_s: float, folder: Path) -> float:
    config = InputsConfig(url="tcp://10.0.0.2:502", inputs={"x": {"address": 0}}, time_offset_s=offset_s)
    device = ModbusInputs("beams", config, Still())
    device._push(InputsReading((True,), ()), NOW, NOW, 1)
    return device.inputs.latest(1.0).t


def encoder(offset_s: float, folder: Path) -> float:
    config = RawCanEncoderConfig(bus="socketcan:can7", id=1, width_bits=8, time_offset_s=offset_s)
    device = RawCanEncoder("belt", config, Still())

    async def take() -> float:
        device._life.begin()
        device._start_counting()
        stamp = SimpleNamespace(t=NOW, dt=0.0, heard=NOW)
        device._stamps = SimpleNamespace(take=lambda frames, looked, now: [stamp])
        device._push([(can.Message(arbitration_id=1, data=b"\x01"), 1)], NOW, NOW)
        return device.counts.latest(1.0).t

    return asyncio.run(take())


def total_station(offset_s: float, folder: Path) -> float:
    config = GeocomConfig(
        url="tcp://10.0.0.3:1212", reflectors={"a": {"constant_m": 0.0}}, time_offset_s=offset_s
    )
    device = GeocomTracker("tracker", config, Still())
    device._push(SimpleNamespace(point=None, t=NOW, dt=0.0, warning=""))
    return device.readings.latest(1.0).t


def line_stream(offset_s: float, folder: Path) -> float:
    config = LineStreamConfig(
        url="tcp://10.0.0.4:5000", serial="1", sigma0_m=1e-5, sigma_per_m=1e-5, length_unit="m",
        reflectors={"a": {}}, columns={"x": 1, "y": 2, "z": 3}, time_offset_s=offset_s,
    )  # fmt: skip
    device = LineStreamTracker("tracker", config, Still())
    device._take(b"1,2,3", NOW, newest=True)
    return device.readings.latest(1.0).t


def observed_registers(offset_s: float, folder: Path) -> float:
    config = ObservedArmConfig(url="tcp://10.0.0.5:502", joints=[{"address": 0}], time_offset_s=offset_s)
    source = RegisterSource("arm", config, Still(), lambda: None)

    async def read(span: Any) -> list[int]:
        return [0] * span.count

    source._link = SimpleNamespace(read=read)
    return asyncio.run(source.look(1))[0].t


def observed_file(offset_s: float, folder: Path) -> float:
    path = folder / "joints.csv"
    path.write_text("j1\n0.1\n")
    config = ObservedArmConfig(url=f"file://{path}", joints=[{"column": "j1"}], time_offset_s=offset_s)
    source = FileSource("arm", config, Still())

    async def look() -> float:
        await source.open()
        with path.open("a") as file:
            file.write("0.2\n")
        return (await source.look(1))[0].t

    return asyncio.run(look())


def line_points(offset_s: float, folder: Path) -> float:
    config = LinePointConfig(
        url="tcp://10.0.0.4:5000", serial="1", sigma0_m=1e-5, sigma_per_m=1e-5, length_unit="m",
        reflectors={"a": {}}, columns={"x": 1, "y": 2, "z": 3}, request="go", time_offset_s=offset_s,
    )  # fmt: skip
    device = LinePointTracker("tracker", config, Still())
    device._ask()
    device._take(b"1,2,3", NOW, newest=True)
    return device.readings.latest(1.0).t


STAMPS: dict[str, Callable[[float, Path], float]] = {
    "ur": arm, "oak": camera, "modbus-inputs": inputs, "raw-can-encoder": encoder, "canopen-encoder": encoder,
    "geocom": total_station, "line-stream": line_stream, "line-points": line_points,
    "observed-arm": observed_registers,
}  # fmt: skip


def test_every_driver_with_an_offset_has_its_test() -> None:
    with_offset = {d for d in DRIVERS if "time_offset_s" in driver_class(d).Config.model_fields}
    assert with_offset == set(STAMPS)


@pytest.mark.parametrize("subject", [*STAMPS.values(), observed_file])
def test_a_positive_offset_makes_a_stamp_earlier_by_just_that(
    subject: Callable[[float, Path], float], tmp_path: Path
) -> None:
    plain = subject(0.0, tmp_path)
    assert subject(0.02, tmp_path) == pytest.approx(plain - 0.02, abs=1e-9)
    assert subject(-0.02, tmp_path) == pytest.approx(plain + 0.02, abs=1e-9)


def test_the_manual_has_one_sentence_for_it_at_every_driver() -> None:
    said = {driver_class(d).Config.model_fields["time_offset_s"].description for d in STAMPS}
    assert len(said) == 1
    assert said.pop().startswith("Subtracted from every stamp")


@pytest.mark.parametrize(("driver", "more"), [("ur", 'host = "10.0.0.1"'), ("oak", "")])
@pytest.mark.parametrize("offset", ["0.02", "-0.02", "0.0"])
def test_an_arm_or_a_camera_with_an_offset_is_told_of_the_sign(
    driver: str, more: str, offset: str, tmp_path: Path
) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(
        'schema = 1\n[cell]\nname = "bay"\n[robot]\n[device.eye]\n'
        f'driver = "{driver}"\ntime_offset_s = {offset}\n{more}\n'
    )
    path.chmod(0o600)
    told = [w for w in load_config(path).warnings if w.startswith(f"{path}:7: device.eye.time_offset_s: ")]
    assert len(told) == (float(offset) != 0.0)
    assert all("change the sign" in warning for warning in told)
