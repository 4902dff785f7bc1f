"""What the config of an input module may say, which spans a poll reads, and how replies are taken apart."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers.modbus.address import ModbusAddress, parse_url
from drivers.modbus.registers import words_to_int
from drivers.modbus_inputs.config import InputsConfig

TCP = "tcp://192.168.10.30:502"


def config(url: str = TCP, inputs: dict[str, Any] | None = None, **keys: Any) -> InputsConfig:
    return InputsConfig(url=url, inputs=inputs or {"xs": {"address": 0}, "ys": {"address": 1}}, **keys)


def spans(subject: InputsConfig) -> list[tuple[int, int, int]]:
    """Function code, first address and count of each request of a poll."""
    return [(s.table.function, s.start, s.count) for s in subject.plan.spans]


@pytest.mark.parametrize(
    ("url", "place"),
    [
        ("tcp://192.168.10.30", ModbusAddress("tcp", "192.168.10.30", 502)),
        ("tcp://io-1.cell:1502", ModbusAddress("tcp", "io-1.cell", 1502)),
        ("tcp://[fe80::1]:502", ModbusAddress("tcp", "fe80::1", 502)),
        ("tls://io-1.cell", ModbusAddress("tls", "io-1.cell", 802)),
        ("rtu:///dev/ttyUSB0", ModbusAddress("rtu", "/dev/ttyUSB0", 0, 115200, "N", 1)),
        (
            "rtu:///dev/ttyS1?baudrate=9600&parity=E&stopbits=2",
            ModbusAddress("rtu", "/dev/ttyS1", 0, 9600, "E", 2),
        ),
    ],
)
def test_a_url_names_the_place(url: str, place: ModbusAddress) -> None:
    assert parse_url(url) == place


@pytest.mark.parametrize(
    ("url", "sentence"),
    [
        ("192.168.10.30:502", "should begin with tcp://, tls:// or rtu://"),
        ("http://192.168.10.30", "should begin with tcp://"),
        ("tcp://", "should be tcp://host:port"),
        ("tcp://a:502/x", "should be tcp://host:port"),
        ("tcp://a:502?unit=3", "should be tcp://host:port"),
        ("tcp://a:70000", "port that is no number from 1 to 65535"),
        ("rtu://dev/ttyUSB0", "with three slashes"),
        ("rtu:///dev/ttyUSB0?baud=9600", "unknown setting 'baud'"),
        ("rtu:///dev/ttyUSB0?baudrate=fast", "baudrate 'fast' is no number"),
        ("rtu:///dev/ttyUSB0?parity=X", "parity 'X' should be N, E or O"),
        ("rtu:///dev/ttyUSB0?stopbits=3", "stopbits '3' should be 1 or 2"),
    ],
)
def test_a_url_that_leads_nowhere_is_refused_with_a_sentence(url: str, sentence: str) -> None:
    with pytest.raises(ValidationError, match="url") as caught:
        config(url)
    assert sentence in str(caught.value)


@given(st.text(max_size=40))
def test_any_url_is_a_place_or_refused_in_words(text: str) -> None:
    try:
        place = parse_url(text)
    except ValueError:
        return
    assert place.host
    assert place.scheme == "rtu" or 1 <= place.port <= 65535


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"inputs": {"xs": {"address": 3}, "ys": {"address": 3}}}, "xs and ys have the same address 3"),
        (
            {"module": "ADAM-6050", "inputs": {"xs": {"address": 12}}},
            "input xs has address 12, but ADAM-6050 has inputs 0 to 11",
        ),
        ({"module": "WAGO-750", "counters": {"address": 0}}, "WAGO-750 has its own"),
        ({"inputs": {"xs": {"address": 0}, "ys": {"address": 5000}}}, "too many for one request"),
        ({"counters": {"address": 65535}}, "too many for one request"),
        ({"tls_ca": "/ca.pem"}, "tls_ca is for a tls:// url"),
        ({"url": "tls://a", "tls_key": "/k.pem"}, "needed together"),
        ({"url": "rtu:///dev/ttyS0", "unit": 0}, "unit 0 is not possible on a serial line"),
        (
            {"url": "rtu:///dev/ttyS0?baudrate=9600", "poll_period_s": 0.005},
            "too short: the bytes of a poll alone take 0.0160 s at 9600 baud",
        ),
        ({"poll_period_s": 0.0005}, "greater than or equal to 0.001"),
        ({"poll_perod_s": 0.005}, "Extra inputs are not permitted"),
    ],
)
def test_settings_that_cannot_work_are_refused_with_a_sentence(keys: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValidationError) as caught:
        config(**keys)
    assert sentence in str(caught.value)


def test_an_iologik_is_read_in_one_span_of_33_registers() -> None:
    subject = config(module="ioLogik-E1210")
    assert spans(subject) == [(4, 0x10, 33)]
    image = [0, 5, 1, 2, *[0] * 28, 0b10]
    reading = subject.plan.decode([image])
    assert reading.levels == (False, True)
    assert reading.counts == (5, 65538)
    assert spans(config(module="ioLogik-E1210", use_counters=False)) == [(4, 0x30, 1)]


def test_an_adam_is_read_counters_first_and_low_word_first() -> None:
    subject = config(module="ADAM-6050", inputs={"a": {"address": 11}, "b": {"address": 2}})
    assert spans(subject) == [(3, 4, 20), (1, 2, 10)]
    counters = [7, 1, *[0] * 16, 9, 2]
    bits = [True, *[False] * 9]
    reading = subject.plan.decode([counters, bits])
    assert reading.levels == (False, True)
    assert reading.counts == (2 * 65536 + 9, 65536 + 7)


def test_a_wago_is_read_as_discrete_inputs_and_has_no_counters() -> None:
    subject = config(module="WAGO-750", inputs={"a": {"address": 9}})
    assert spans(subject) == [(2, 9, 1)]
    assert subject.plan.decode([[True]]).counts == ()


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({}, [(2, 0, 2)]),
        ({"levels": {"table": "coils", "address": 100}}, [(1, 100, 2)]),
        ({"levels": {"table": "holding", "address": 8}}, [(3, 8, 1)]),
        ({"counters": {"address": 40}}, [(4, 40, 4), (2, 0, 2)]),
        (
            {"levels": {"table": "input", "address": 8}, "counters": {"address": 10, "width": 16}},
            [(4, 8, 4)],
        ),
        (
            {"levels": {"table": "input", "address": 900}, "counters": {"address": 10}},
            [(4, 10, 4), (4, 900, 1)],
        ),
    ],
)
def test_a_generic_module_is_read_where_the_config_says(
    keys: dict[str, Any], expected: list[tuple[int, int, int]]
) -> None:
    assert spans(config(**keys)) == expected


def test_bits_of_registers_are_counted_on_through_the_words() -> None:
    subject = config(
        levels={"table": "holding", "address": 8}, inputs={"a": {"address": 15}, "b": {"address": 17}}
    )
    assert spans(subject) == [(3, 8, 2)]
    assert subject.plan.decode([[0x8000, 0b01]]).levels == (True, False)
    assert subject.plan.decode([[0x0000, 0b10]]).levels == (False, True)


@given(st.integers(0, 2**32 - 1))
def test_words_make_the_number_in_either_order(number: int) -> None:
    high, low = divmod(number, 65536)
    assert words_to_int([high, low], low_word_first=False) == number
    assert words_to_int([low, high], low_word_first=True) == number
