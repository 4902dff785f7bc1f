"""The register table and the requests that address it, without sockets."""

import math
from collections.abc import Sequence
from importlib.metadata import version

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.client.mixin import ModbusClientMixin

from cell.packml import PackML
from daemon.modbus import Command, register_table
from daemon.modbus.pdu import ModbusError, respond

TABLE = register_table()
STATUS = {register.name: register for register in TABLE.status}


def test_registers_do_not_overlap_and_stay_in_their_blocks() -> None:
    for registers, size in (
        (TABLE.command, TABLE.command_size),
        (TABLE.status, TABLE.status_size),
        (TABLE.readable, TABLE.readable_size),
    ):
        used = [a for r in registers for a in range(r.address, r.address + r.words)]
        assert len(used) == len(set(used))
        assert max(used) < size
        assert len({r.name for r in registers}) == len(registers)


@pytest.mark.parametrize(
    ("name", "address", "type_"),
    [
        ("status", 0, "uint16"), ("acknowledged_sequence", 1, "uint16"), ("result_code", 2, "uint16"),
        ("heartbeat", 3, "uint16"), ("packml_state", 4, "uint16"), ("active_job", 5, "uint16"),
        ("error_code", 6, "uint16"), ("warning_bits", 7, "uint16"), ("protocol_version", 8, "uint16"),
        ("config_checksum", 9, "uint16"), ("run_id", 10, "uint32"), ("step", 12, "uint16"),
        ("steps", 13, "uint16"), ("prompt_id", 14, "uint32"), ("belt_speed_m_s", 16, "float32"),
        ("belt_position_m", 18, "float32"), ("picks", 20, "uint32"), ("misses", 22, "uint32"),
        ("uptime_s", 24, "uint32"), ("queue_length", 26, "uint16"), ("next_place", 27, "uint16"),
        ("place_waits", 55, "uint16"), ("target_x_m", 56, "float32"), ("target_yaw_rad", 62, "float32"),
        ("spread_within_m", 28, "float32"),
        ("spread_across_m", 30, "float32"), ("tool_offset_x_m", 32, "float32"),
        ("tool_offset_z_m", 36, "float32"), ("tool_tilt_rad", 38, "float32"),
        ("kinematic_rms_m", 40, "float32"), ("predicted_95_m", 42, "float32"),
        ("missed_not_detected", 44, "uint32"), ("missed_grip_failed", 50, "uint32"),
    ],
)  # fmt: skip
def test_the_status_block_is_where_the_contract_has_it(name: str, address: int, type_: str) -> None:
    assert (STATUS[name].address, STATUS[name].type) == (address, type_)


@pytest.mark.parametrize(
    ("register", "names"),
    [
        (
            "status",
            (
                "ready", "busy", "done", "fault", "warning", "reserved, 0", "result valid", "arm ok",
                "camera ok", "encoder ok", "beams ok", "tracker ok", "PLC heartbeat ok",
                "protective or emergency stop", "twin", "toggles with the heartbeat",
            ),
        ),
        ("control", ("enable", "reserved", "no new picks", "fault reset")),
    ],
)  # fmt: skip
def test_every_bit_is_where_the_contract_has_its_name(register: str, names: tuple[str, ...]) -> None:
    assert [TABLE.bit(register, name) for name in names] == [2**i for i in range(len(names))]


@pytest.mark.parametrize(("register", "name"), [("status", "redy"), ("stat", "ready"), ("run_id", "ready")])
def test_a_bit_that_the_table_does_not_have_is_a_defect(register: str, name: str) -> None:
    with pytest.raises(KeyError):
        TABLE.bit(register, name)


def test_state_numbers_are_packmls() -> None:
    names = {number: text.replace("-", "") for number, text in STATUS["packml_state"].values.items()}
    assert names == {int(state): state.name.lower() for state in PackML}


@given(
    st.sampled_from(["uint32", "float32"]),
    st.booleans(),
    st.integers(0, 2**32 - 1),
    st.floats(width=32, allow_nan=False, allow_infinity=False),
)
def test_32_bit_values_agree_with_pymodbus_own_codec(type_: str, low: bool, whole: int, real: float) -> None:
    register = STATUS["run_id"] if type_ == "uint32" else STATUS["belt_speed_m_s"]
    value = whole if type_ == "uint32" else max(min(real, 3.4e38), -3.4e38)
    words = register.encode(value, low)
    kind = ModbusClientMixin.DATATYPE.UINT32 if type_ == "uint32" else ModbusClientMixin.DATATYPE.FLOAT32
    theirs = ModbusClientMixin.convert_from_registers(words, kind, word_order="little" if low else "big")
    assert theirs == pytest.approx(value, rel=1e-6)
    assert register.decode(words, low) == theirs


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("step", 70000, [0xFFFF]),
        ("step", -1, [0]),
        ("step", None, [0]),
        ("run_id", 2**40, [0xFFFF, 0xFFFF]),
        ("belt_speed_m_s", math.nan, [0, 0]),
        ("belt_speed_m_s", math.inf, [0, 0]),
        ("belt_speed_m_s", 1.0, [0x3F80, 0]),
    ],
)
def test_values_that_do_not_fit_saturate_and_unknown_ones_are_zero(
    name: str, value: float | None, expected: list[int]
) -> None:
    assert STATUS[name].encode(value, False) == expected


def test_a_status_name_that_the_table_does_not_know_is_a_defect() -> None:
    with pytest.raises(KeyError, match="belt_sped"):
        TABLE.readable_words({"belt_sped": 1.0}, False)


def test_arguments_are_read_as_uint32_in_either_word_order() -> None:
    assert Command(8, 1, args=(1, 2, 0, 7, 0, 0)).argument_uint32 == 65538
    assert Command(8, 1, args=(2, 1, 0, 0, 0, 0), low_first=True).argument_uint32 == 65538
    assert Command(8, 1, args=(1, 2, 0, 7, 0, 0)).argument_as_uint32(1) == 7


def test_the_numbers_of_later_jobs_are_reserved_and_not_documented_as_jobs() -> None:
    job = next(r for r in TABLE.command if r.name == "job")
    assert set(job.reserved) == {12}
    assert not set(job.reserved) & job.values.keys()


class Memory:
    """Holding registers 0..9 that take anything, input registers and discrete inputs that count."""

    def __init__(self) -> None:
        self.words = list(range(10))

    def read_discrete(self, address: int, count: int) -> Sequence[bool]:
        return [(address + i) % 3 == 0 for i in range(count)]

    def read_input(self, address: int, count: int) -> Sequence[int]:
        return list(range(address, address + count))

    def read_holding(self, address: int, count: int) -> Sequence[int]:
        if address + count > 10:
            raise ModbusError(2)
        return self.words[address : address + count]

    def write_holding(self, address: int, values: Sequence[int], client: str) -> None:
        self.read_holding(address, len(values))
        self.words[address : address + len(values)] = values

    def write_coils(self, address: int, client: str) -> None:
        raise ModbusError(2)


@pytest.fixture
def subject() -> Memory:
    return Memory()


@pytest.mark.parametrize(
    ("request_hex", "reply_hex"),
    [
        ("02 0000 000A", "02 02 49 02"),  # bits 0, 3, 6 and 9
        ("03 0002 0003", "03 06 0002 0003 0004"),
        ("04 0100 0001", "04 02 0100"),
        ("06 0004 ABCD", "06 0004 ABCD"),
        ("10 0001 0002 04 0007 0008", "10 0001 0002"),
        ("16 0004 00F2 0025", "16 0004 00F2 0025"),
        ("17 0003 0002 0001 0001 02 0063", "17 04 0003 0004"),
        ("03 0009 0002", "83 02"),
        ("03 0000 0000", "83 03"),
        ("03 0000 007E", "83 03"),
        ("04 0000 007E", "84 03"),
        ("02 0000 07D1", "82 03"),
        ("10 0001 0002 03 0007 0008", "90 03"),
        ("10 0001 0000 00", "90 03"),
        ("10 0009 0002 04 0007 0008", "90 02"),
        ("17 0003 007E 0001 0001 02 0063", "97 03"),
        ("17 0009 0002 0001 0001 02 0063", "97 02"),
        ("06 0004", "86 03"),
        ("10", "90 03"),
        ("01 0000 0001", "81 02"),
        ("05 0000 FF00", "85 02"),
        ("0F 0000 0001 01 01", "8F 02"),
        ("2B 0D 00 00", "AB 01"),
        ("63", "E3 01"),
    ],
)
def test_requests_and_replies_byte_by_byte(subject: Memory, request_hex: str, reply_hex: str) -> None:
    """The frames follow the MODBUS Application Protocol Specification V1.1b3."""
    assert respond(subject, bytes.fromhex(request_hex), "x").hex() == reply_hex.replace(" ", "").lower()


def test_mask_write_follows_the_example_of_the_specification(subject: Memory) -> None:
    subject.words[4] = 0x12
    respond(subject, bytes.fromhex("16 0004 00F2 0025"), "x")
    assert subject.words[4] == 0x17


def test_a_read_write_that_cannot_read_does_not_write(subject: Memory) -> None:
    respond(subject, bytes.fromhex("17 0009 0002 0001 0001 02 0063"), "x")
    assert subject.words == list(range(10))


def test_a_read_write_reads_what_it_wrote(subject: Memory) -> None:
    assert respond(subject, bytes.fromhex("17 0001 0001 0001 0001 02 0063"), "x").hex() == "17020063"


@given(st.binary(min_size=1, max_size=253))
def test_any_request_has_a_reply_that_fits_a_frame(request_bytes: bytes) -> None:
    reply = respond(Memory(), request_bytes, "x")
    assert 2 <= len(reply) <= 253
    assert reply[0] & 0x7F == request_bytes[0] & 0x7F


@pytest.mark.parametrize(
    ("pdu", "objects"), [("2b0e0100", [0, 1, 2]), ("2b0e0402", [2]), ("2b0e0309", [0, 1, 2])]
)
def test_the_device_identifies_itself_with_its_basic_objects(pdu: str, objects: list[int]) -> None:
    reply = respond(Memory(), bytes.fromhex(pdu), "10.0.0.1")
    assert reply[:3] == bytes.fromhex(pdu)[:3]
    assert reply[6] == len(objects)
    assert reply[7] == objects[0]
    assert reply.endswith(version("cellward").encode())


@pytest.mark.parametrize(
    ("pdu", "reply"), [("2b0d0100", "ab01"), ("2b0e0900", "ab03"), ("2b0e0403", "ab02"), ("2b0e01", "ab03")]
)
def test_an_identification_that_is_not_there_is_refused(pdu: str, reply: str) -> None:
    assert respond(Memory(), bytes.fromhex(pdu), "10.0.0.1").hex() == reply
