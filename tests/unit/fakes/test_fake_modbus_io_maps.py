"""Registers, exceptions and framing of the fake input module, without sockets."""

import struct
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cell.errors import CellError
from fakes.modbus_io import Identity, Module, register_map, rtu, tcp
from fakes.modbus_io.pdu import respond

COUNTS = (70000, 3, 0xFFFFFFFF)


@dataclass
class Wired:
    """Inputs that the test sets."""

    level: tuple[bool, ...] = (True, False, True)
    count: tuple[int, ...] = COUNTS
    asked: int = 0

    def levels(self, t: float) -> tuple[bool, ...]:
        self.asked += 1
        return self.level

    def counts(self, t: float) -> tuple[int, ...]:
        return self.count

    def reboot(self, t: float) -> None:
        self.count = (0,) * len(self.count)


def module_of(make: str, wired: Wired | None = None, **keys: bool) -> Module:
    return Module(wired or Wired(), register_map(make, **keys), Identity(make), lambda: 0.0)


def ask(module: Module, text: str) -> str:
    return respond(module, bytes.fromhex(text)).hex()


def words(module: Module, function: int, address: int, count: int) -> list[int]:
    reply = respond(module, struct.pack(">BHH", function, address, count))
    assert reply[0] == function, reply.hex()
    return list(struct.unpack(f">{count}H", reply[2:]))


def test_a_generic_module_has_levels_at_fc2_and_counters_at_fc4() -> None:
    module = module_of("generic")
    assert ask(module, "0200000003") == "020105"
    assert ask(module, "0200000010") == "02020500"
    assert words(module, 4, 0, 6) == [1, 70000 - 65536, 0, 3, 0xFFFF, 0xFFFF]
    low_first = module_of("generic", low_word_first=True)
    assert words(low_first, 4, 0, 4) == [70000 - 65536, 1, 3, 0]


def test_an_iologik_has_counters_and_levels_in_one_read_of_33_registers() -> None:
    module = module_of("ioLogik-E1210")
    image = words(module, 4, 0x10, 33)
    assert image[:6] == [1, 70000 - 65536, 0, 3, 0xFFFF, 0xFFFF]
    assert image[32] == 0b101
    assert ask(module, "0200000010") == "02020500"
    assert ask(module, "01010000 03".replace(" ", "")) == "010107", "counters run"


def test_an_adam_has_low_words_first_and_its_inputs_among_the_coils() -> None:
    module = module_of("ADAM-6050")
    assert words(module, 3, 0, 6) == words(module, 4, 0, 6) == [70000 - 65536, 1, 3, 0, 0xFFFF, 0xFFFF]
    assert ask(module, "010000000c") == ask(module, "020000000c").replace("0202", "0102") == "01020500"
    assert words(module, 3, 300, 1) == [0b101]


def test_a_wago_coupler_has_an_image_of_bits_and_words_and_tells_its_size() -> None:
    module = module_of("WAGO-750")
    assert ask(module, "0200000010") == "02020500"
    assert words(module, 3, 0, 1) == words(module, 4, 0, 1) == [0b101]
    assert words(module, 3, 0x1022, 4) == [0, 0, 8, 16]
    assert ask(module, "0600000081") == "0600000081"
    assert words(module, 3, 0x200, 1) == [0x81]
    assert ask(module, "0502010000") == "0502010000"
    assert ask(module, "0502070000") == "0502070000"
    assert ask(module, "0102000008") == "010101"


@pytest.mark.parametrize(
    ("make", "clear", "stop", "start", "at"),
    [
        ("ioLogik-E1210", "050110ff00", "0501000000", "050100ff00", (4, 0x10)),
        ("ADAM-6050", "050021ff00", "0500200000", "050020ff00", (3, 0)),
    ],
)
def test_a_counter_is_cleared_stopped_and_started_by_coils(
    make: str, clear: str, stop: str, start: str, at: tuple[int, int]
) -> None:
    wired = Wired()
    module = module_of(make, wired)

    def value() -> int:
        a, b = words(module, *at, 2)
        return b << 16 | a if make == "ADAM-6050" else a << 16 | b

    assert value() == 70000
    assert ask(module, clear) == clear
    assert value() == 0
    wired.count = (70005, 3, 0)
    assert value() == 5
    assert ask(module, stop) == stop
    wired.count = (70009, 3, 0)
    assert value() == 5
    assert ask(module, start) == start
    wired.count = (70010, 3, 0)
    assert value() == 6


def test_a_counter_that_wraps_shows_its_overflow_until_that_is_cleared() -> None:
    wired = Wired()
    module = module_of("ioLogik-E1210", wired)
    assert ask(module, "0101220001") == "010100"
    wired.count = (70000, 3, 2)
    assert words(module, 4, 0x14, 2) == [0, 2]
    assert ask(module, "0101220001") == "010101"
    assert ask(module, "0501220000") == "0501220000"
    assert ask(module, "0101220001") == "010100"


def test_writing_the_registers_of_a_generic_module_sets_its_counter() -> None:
    wired = Wired()
    module = module_of("generic", wired)
    assert ask(module, "100000000204fffffffe") == "1000000002"
    wired.count = (70003, 3, 0)
    assert words(module, 4, 0, 2) == [0, 1], "it wraps at 2^32"
    assert ask(module, "0600010007") == "0600010007"
    assert words(module, 4, 0, 2) == [0, 7]
    assert ask(module, "0f00000003 0105".replace(" ", "")) == "0f00000003"
    assert words(module, 4, 0, 6) == [0, 0, 0, 3, 0, 0], "coils 0 and 2 were on: those counters are clear"


@pytest.mark.parametrize(
    ("make", "request_", "reply"),
    [
        ("generic", "0400000002", "8402"),
        ("generic", "0300000002", "8302"),
        ("generic", "0100000001", "8102"),
        ("generic", "050000ff00", "8502"),
        ("generic", "0600000001", "8602"),
        ("ioLogik-E1210", "0400100002", "040400000000"),
    ],
)
def test_a_plain_module_without_counters_has_no_registers_for_them(
    make: str, request_: str, reply: str
) -> None:
    module = module_of(make, Wired(count=()))
    assert ask(module, request_) == reply
    assert ask(module, "0200000003") == "020105"


@pytest.mark.parametrize(
    ("make", "request_", "reply"),
    [
        ("generic", "0200000000", "8203"),
        ("generic", "02000007d1", "8203"),
        ("generic", "0200000011", "8202"),
        ("generic", "02ffff0002", "8202"),
        ("generic", "040000007e", "8403"),
        ("generic", "0400200001", "8402"),
        ("generic", "0500001234", "8503"),
        ("generic", "050010ff00", "8502"),
        ("generic", "0600200000", "8602"),
        ("generic", "10000000020200 01".replace(" ", ""), "9003"),
        ("generic", "0f0000000901ff", "8f03"),
        ("generic", "0700", "8701"),
        ("generic", "ff", "ff01"),
        ("generic", "02", "8203"),
        ("generic", "02000000", "8203"),
        ("ioLogik-E1210", "0501100000", "8503"),
        ("ioLogik-E1210", "050120ff00", "8503"),
        ("ioLogik-E1210", "0300000001", "8302"),
        ("ioLogik-E1210", "04000f0002", "8402"),
        ("ioLogik-E1210", "0600100001", "8602"),
        ("ADAM-6050", "050000ff00", "8502"),
        ("ADAM-6050", "01000c0001", "8102"),
        ("WAGO-750", "0600010001", "8602"),
        ("WAGO-750", "050008ff00", "8502"),
    ],
)
def test_what_is_not_there_is_exception_2_and_a_bad_value_exception_3(
    make: str, request_: str, reply: str
) -> None:
    assert ask(module_of(make), request_) == reply


def test_a_write_of_several_is_done_whole_or_not_at_all() -> None:
    module = module_of("ADAM-6050")
    assert ask(module, "0f0010000701ff") == "8f02", "there are 6 outputs"
    assert words(module, 3, 302, 1) == [0]
    assert ask(module, "0f0010000601ff") == "0f00100006"
    assert words(module, 3, 302, 1) == [0x3F]


def test_a_read_of_many_registers_asks_the_inputs_once() -> None:
    wired = Wired()
    module = module_of("ioLogik-E1210", wired)
    wired.asked = 0
    words(module, 4, 0x10, 33)
    assert wired.asked == 1


def test_a_restart_forgets_clears_stops_and_outputs() -> None:
    wired = Wired()
    module = module_of("ADAM-6050", wired)
    for write in ("050021ff00", "0500240000", "050010ff00"):  # clear 0, stop 1, output 0
        assert ask(module, write) == write
    module.restart("99993300099")
    wired.count = (8, 9, 10)
    assert words(module, 3, 0, 6) == [8, 0, 9, 0, 10, 0]
    assert words(module, 3, 302, 1) == [0]
    assert module.identity.serial == "99993300099"


def test_more_inputs_than_the_module_has_are_refused() -> None:
    with pytest.raises(CellError, match="ADAM-6050 has 12 inputs, 13 are wired"):
        module_of("ADAM-6050", Wired((False,) * 13, (0,) * 13))


def test_identification_tells_vendor_product_revision_and_a_serial_of_a_twin() -> None:
    module = module_of("generic")
    basic = respond(module, bytes.fromhex("2b0e0100"))
    assert basic[:7] == bytes.fromhex("2b0e0183000003")
    assert b"generic" in basic
    assert b"9999" not in basic
    everything = respond(module, bytes.fromhex("2b0e0300"))
    assert everything[6] == 4
    assert everything.endswith(bytes([0x80, 11]) + b"99993300001")
    assert respond(module, bytes.fromhex("2b0e0480"))[6:] == bytes([1, 0x80, 11]) + b"99993300001"
    assert ask(module, "2b0e0403") == "ab02"
    assert ask(module, "2b0e0500") == "ab03"
    assert ask(module, "2b0d0100") == "ab01"


def test_a_long_identification_comes_in_two_replies() -> None:
    identity = Identity("p" * 100, vendor="v" * 100, revision="r" * 100)
    module = Module(Wired(), register_map("generic"), identity, lambda: 0.0)
    first = respond(module, bytes.fromhex("2b0e0100"))
    assert (first[4], first[5], first[6]) == (0xFF, 2, 2)
    second = respond(module, bytes.fromhex("2b0e0102"))
    assert (second[4], second[5], second[6]) == (0, 0, 1)
    assert second.endswith(b"r" * 100)


@given(
    st.sampled_from(["generic", "ioLogik-E1210", "ADAM-6050", "WAGO-750"]),
    st.binary(min_size=1, max_size=253),
)
def test_no_request_is_a_defect(make: str, request_: bytes) -> None:
    reply = respond(module_of(make), request_)
    assert reply[0] & 0x7F == request_[0] & 0x7F
    assert len(reply) <= 253


REQUESTS = st.lists(
    st.builds(tcp.Request, st.integers(0, 65535), st.integers(0, 255), st.binary(min_size=1, max_size=253)),
    max_size=8,
)


@given(requests=REQUESTS, cuts=st.lists(st.integers(1, 40), max_size=40))
def test_tcp_frames_survive_any_cutting_of_the_stream(requests: list[tcp.Request], cuts: list[int]) -> None:
    framer, found = tcp.Framer(), []
    stream = b"".join(tcp.frame(r.transaction, r.unit, r.pdu) for r in requests)
    for cut in [*cuts, len(stream)]:
        framer.feed(stream[:cut])
        stream = stream[cut:]
        while (request := framer.next()) is not None:
            found.append(request)
    assert found == requests
    assert len(framer) == 0


@pytest.mark.parametrize("header", ["00010001000601", "00010000000101", "00010000 00ff01"])
def test_a_header_with_another_protocol_or_an_impossible_length_is_no_modbus(header: str) -> None:
    framer = tcp.Framer()
    framer.feed(bytes.fromhex(header))
    with pytest.raises(tcp.FramingError):
        framer.next()


@pytest.mark.parametrize("good", ["010300000001840a", "1101001300250e84"])
def test_the_crc_has_the_values_that_are_published(good: str) -> None:
    frame = bytes.fromhex(good)
    assert rtu.parse(frame) == (frame[0], frame[1:-2])
    assert rtu.frame(frame[0], frame[1:-2]) == frame
    assert rtu.parse(frame[:-1] + b"\0") is None


@pytest.mark.parametrize("length", [0, 1, 3, 257])
def test_too_few_or_too_many_bytes_are_no_frame_even_with_a_good_crc(length: int) -> None:
    body = bytes(max(length - 2, 0))
    assert rtu.parse((body + rtu.crc16(body).to_bytes(2, "little"))[:length]) is None


def test_the_silence_between_frames_is_three_and_a_half_characters_and_fixed_at_high_speed() -> None:
    assert rtu.silence_s(9600) == pytest.approx(0.00401, abs=1e-5)
    assert rtu.silence_s(115200) == 0.00175
