"""What was put into effect last, and the tool's pose, as a PLC reads them."""

import asyncio
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pyModbusTCP.client import ModbusClient
from pyModbusTCP.utils import decode_ieee, word_list_to_long

from cell.clock import MonotonicClock
from cell.store.ledger import Ledger
from daemon import values
from daemon.committed_registers import committed_registers
from daemon.config import CellConfig, ModbusSection
from daemon.modbus import ModbusFace, register_table
from tests.kit.object_cell import write_config

HOST = "127.0.0.45"
CAMERA, TOOL = "T_flange_camera", "T_flange_tool.gripper"
POSE = [0.1, -0.2, 0.3, 0.01, -0.02, 0.03]
OTHER = [0.5, 0.6, 0.7, 0.0, 0.0, 1.0]


@pytest.fixture
def config(tmp_path: Path) -> CellConfig:
    return write_config(tmp_path, "slot")


@pytest.fixture
def ledger(tmp_path: Path) -> Iterator[Ledger]:
    with_ledger = Ledger(tmp_path / "ledger.sqlite", wall=lambda: 1_800_000_000.0)
    yield with_ledger
    with_ledger.close()


def commit(ledger: Ledger, name: str, value: Any, configured: Any = None) -> None:
    ledger.accept(ledger.propose(name, value, {}, 1, configured), "test")


def pose_of(subject: dict[str, float], prefix: str) -> list[float]:
    return [subject[f"{prefix}_{axis}"] for axis in ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")]


def test_before_anything_is_committed_the_tool_is_the_configured_one(
    config: CellConfig, ledger: Ledger
) -> None:
    subject = committed_registers(config, ledger.versions_now())
    assert (subject["tool_version"], pose_of(subject, "tool")) == (0, list(config.robot.tool.T_flange_tool))
    assert "change_count" not in subject


def test_a_commit_shows_kind_version_time_and_pose_and_leaves_the_tool_alone(
    config: CellConfig, ledger: Ledger
) -> None:
    commit(ledger, TOOL, POSE)
    commit(ledger, CAMERA, OTHER)
    subject = committed_registers(config, ledger.versions_now())
    assert (subject["change_count"], subject["change_count_again"]) == (2, 2)
    assert (subject["changed_calibration"], subject["changed_version"]) == (1, 1)
    assert subject["changed_at_s"] == 1_800_000_000
    assert (pose_of(subject, "changed"), pose_of(subject, "tool")) == (OTHER, POSE)
    assert subject["tool_version"] == 1


def test_a_rollback_is_a_change_to_what_is_in_effect_then(config: CellConfig, ledger: Ledger) -> None:
    nominal = list(config.robot.tool.T_flange_tool)
    commit(ledger, TOOL, OTHER, nominal)
    commit(ledger, TOOL, POSE, nominal)
    values.tell_configured(config, ledger)
    for count, version, pose in ((3, 1, OTHER), (4, 0, nominal)):
        ledger.rollback(TOOL, "test")
        subject = committed_registers(config, ledger.versions_now())
        assert (subject["change_count"], subject["changed_calibration"]) == (count, 3)
        assert (subject["changed_version"], subject["tool_version"]) == (version, version)
        assert pose_of(subject, "changed") == pose_of(subject, "tool") == pose


def test_what_is_no_pose_shows_none_and_a_decision_that_changes_nothing_counts_as_none(
    config: CellConfig, ledger: Ledger
) -> None:
    commit(ledger, "belt.belt", {"m_per_count": 1e-4, "dir": [1, 0, 0]})
    subject = committed_registers(config, ledger.versions_now())
    assert (subject["changed_calibration"], "changed_x_m" in subject) == (6, False)
    ledger.accept(1, "test")  # confirmed once more
    waiting = ledger.propose(TOOL, POSE, {}, 1, None)
    ledger.reject(waiting, "test", "no")
    assert committed_registers(config, ledger.versions_now()) == subject
    commit(ledger, "acme_thing", 5)
    assert committed_registers(config, ledger.versions_now())["changed_calibration"] == 255


def test_a_restart_shows_the_same_and_goes_on_counting(config: CellConfig, tmp_path: Path) -> None:
    before = Ledger(tmp_path / "ledger.sqlite")
    commit(before, TOOL, POSE)
    shown = committed_registers(config, before.versions_now())
    before.close()
    subject = Ledger(tmp_path / "ledger.sqlite")
    assert committed_registers(config, subject.versions_now()) == shown
    commit(subject, TOOL, OTHER)
    assert committed_registers(config, subject.versions_now())["change_count"] == 2
    subject.set_state("last_change", None)  # as in a ledger of an earlier program
    subject.close()
    older = Ledger(tmp_path / "ledger.sqlite")
    found = committed_registers(config, older.versions_now())
    older.close()
    assert (found["change_count"], found["changed_version"], pose_of(found, "changed")) == (1, 2, OTHER)


def test_every_calibration_of_ours_has_a_number() -> None:
    told = register_table().register("changed_calibration")
    ours = {"T_flange_camera", "T_base_camera", "T_flange_tool", "laser_reference", "kinematics", "belt"}
    assert len({told.number(name) for name in ours | {"time_offset_s", "something"}}) == len(ours) + 2


@pytest.mark.wire
def test_a_client_that_is_not_ours_never_reads_half_of_a_change(config: CellConfig, ledger: Ledger) -> None:
    """Each version has its own number as x of its pose; pyModbusTCP reads while they are committed."""
    done, read = threading.Event(), list[tuple[int, ...]]()

    def write() -> None:
        for number in range(1, 61):
            commit(ledger, TOOL, [float(number), *POSE[1:]])
        done.set()

    def visit(host: str, port: int) -> None:
        client = ModbusClient(host, port, timeout=5.0)
        writer = threading.Thread(target=write)
        writer.start()
        try:
            while not done.is_set():
                read.append(tuple(client.read_input_registers(64, 32) or ()))
            time.sleep(0.05)  # a reading may be 10 ms old
            read.append(tuple(client.read_input_registers(64, 32) or ()))
            assert client.read_holding_registers(1064, 32) == list(read[-1]), "the mirror"
        finally:
            writer.join()
            client.close()

    async def handle(command: Any) -> int:
        return 1

    async def scene() -> None:
        section = ModbusSection(bind=f"{HOST}:0")
        face = ModbusFace(
            section,
            MonotonicClock(),
            handle,
            lambda: {"status": 1, **committed_registers(config, ledger.versions_now())},
        )
        await face.start()
        try:
            await asyncio.to_thread(visit, *face.address)
        finally:
            await face.stop()

    asyncio.run(scene())
    for words in read:
        x, tool_x = (decode_ieee(word_list_to_long(words[i : i + 2])[0]) for i in (6, 18))
        assert words[0] == words[31] == words[2] == words[3] == x == tool_x or not any(words[:3])
    assert len({words[0] for words in read}) > 5, "it read while versions changed"
    assert read[-1][0] == 60
