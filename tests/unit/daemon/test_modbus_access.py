"""Who may write over Modbus, what of it is audited, and what is refused as not there."""

from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from daemon.modbus import ModbusFace
from daemon.modbus.pdu import respond
from tests.kit.modbus_face_rig import HOST, Client, Plant, face_of, plant, subject, talk

__all__ = ["plant", "subject"]
pytestmark = pytest.mark.wire


@pytest.mark.parametrize(
    ("pdu", "reply"),
    [
        ("0600200001", "8602"),  # behind the command block
        ("06001f0001", "06001f0001"),  # its last register
        ("0603e80001", "8602"),  # the mirror is for reading
        ("10001f0002040001 0001", "9002"),
        ("060000000c", "8603"),  # there is no command 12
        ("06000b0010", "8603"),  # there is no control bit 4
        ("0300000021", "8302"),
        ("0300200001", "8302"),
        ("0303e80061", "8302"),
        ("0400600001", "8402"),
        ("020000 0021", "8202"),
        ("0500000000", "8502"),
    ],
)
def test_what_is_not_there_is_exception_2_and_a_bad_value_exception_3(
    subject: ModbusFace, pdu: str, reply: str
) -> None:
    async def script(plc: Client) -> None:
        assert await plc.ask(pdu) == reply

    talk(subject, script)


def test_a_write_of_several_registers_is_taken_whole_or_not_at_all(plant: Plant, subject: ModbusFace) -> None:
    async def script(plc: Client) -> None:
        assert await plc.write(0, 1, 5, 1, 0, 0, 0, 0, 0, 0, 0, 0, 999) == "9003"
        assert await plc.ask("0300000003") == "0306" + "0000" * 3

    talk(subject, script)
    assert plant.commands == []


@pytest.mark.parametrize(
    ("keys", "source", "why"),
    [
        ({"allow_write": False}, HOST, "allow_write is false"),
        ({"allow_clients": []}, HOST, "not in [modbus] allow_clients"),
        ({"allow_clients": ["127.0.0.41"]}, HOST, "not in [modbus] allow_clients"),
        ({"allow_clients": ["10.0.0.0/8"]}, "127.0.0.42", "not in [modbus] allow_clients"),
    ],
)
def test_who_may_not_write_reads_all_the_same_and_the_attempt_is_audited(
    plant: Plant, keys: dict[str, Any], source: str, why: str
) -> None:
    async def script(plc: Client) -> None:
        assert await plc.write(0, 1, 5, 1) == "9002"
        assert (await plc.words(0, 1))[0] & 1

    talk(face_of(plant, **keys), script, source)
    assert plant.commands == []
    ((who, what, accepted, detail),) = plant.audit
    assert (who, what, accepted) == (source, "write 0..2", False)
    assert why in detail


def test_a_listed_client_may_write(plant: Plant) -> None:
    async def script(plc: Client) -> None:
        await plc.write(0, 1, 5, 1)
        await plc.acknowledged(5)

    talk(face_of(plant, allow_clients=["10.0.0.0/8", "127.0.0.43"]), script, "127.0.0.43")
    assert len(plant.commands) == 1


def test_writes_and_what_became_of_them_are_audited_but_not_each_heartbeat(
    plant: Plant, subject: ModbusFace
) -> None:
    async def script(plc: Client) -> None:
        for beat in range(1, 20):
            await plc.write(10, beat)
        await plc.write(0, 1, 5, 1)
        await plc.acknowledged(5)
        await plc.write(20, 1)
        await plc.write(40, 1)

    talk(subject, script)
    assert [(what, accepted) for _, what, accepted, _ in plant.audit] == [
        ("write 0..2", True),
        ("command 1 sequence 5 job 1", True),
        ("write 20", True),
        ("write 40", False),
    ]


def test_a_flood_of_refused_writes_is_counted_not_listed_without_end(
    plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.auditor.OWN_LINES", 5)
    subject = face_of(plant, allow_write=False)

    async def script(plc: Client) -> None:
        plc.writer.write(b"".join(plc.frame("0600000001") for _ in range(40)))
        for _ in range(40):
            await plc.reply()

    talk(subject, script)
    listed = [line for line in plant.audit if line[1] == "write 0"]
    counted = sum(int(line[1].split()[0]) for line in plant.audit if "refused writes" in line[1])
    assert len(listed) + counted == 40
    assert (len(listed), counted) == (5, 35)


@given(st.binary(min_size=1, max_size=253))
@example(bytes.fromhex("17000000010000000102000b"))
def test_no_request_of_a_stranger_is_a_defect_or_gets_more_than_a_reading(request_bytes: bytes) -> None:
    plant = Plant()
    subject = face_of(plant, allow_clients=["10.0.0.1"])
    reply = respond(subject, request_bytes, "127.0.0.99")
    assert reply[0] & 0x7F == request_bytes[0] & 0x7F
    assert plant.commands == []
    assert subject.read_holding(0, 32) == [0] * 32
