"""Framing to the motion child, the primary port's packages, and small translations."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from cell.errors import CellError, error
from cell.poses import from_pose6, to_pose6
from drivers.ur.config import UrConfig
from drivers.ur.dashboard import model_name
from drivers.ur.framing import Unframer, encode
from drivers.ur.kinematics import describe
from drivers.ur.motion_checks import open_failure, shortened
from drivers.ur.primary import PrimarySplitter, parse_kinematics, parse_tcp_offset, sub_packages

_JSON = st.dictionaries(
    st.text(max_size=8), st.one_of(st.integers(), st.floats(allow_nan=False, allow_infinity=False), st.text())
)


@given(st.lists(_JSON, max_size=6), st.integers(1, 50))
def test_messages_survive_any_cut_of_the_pipe(messages: list[dict], step: int) -> None:
    wire = b"".join(encode(m) for m in messages)
    subject = Unframer()
    found = [m for at in range(0, len(wire), step) for m in subject.feed(wire[at : at + step])]
    assert found == messages


def test_a_message_with_a_number_that_is_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match="JSON compliant"):
        encode({"q": float("nan")})


@pytest.mark.parametrize("wire", [b"\xff\xff\xff\xff", b"\x00\x00\x00\x02[]"])
def test_what_is_not_one_of_our_messages_is_refused(wire: bytes) -> None:
    with pytest.raises(ValueError, match="message"):
        Unframer().feed(wire)


def package(kind: int, body: bytes) -> bytes:
    return struct.pack(">iB", 5 + len(body), kind) + body


def test_the_active_tcp_is_the_second_pose_of_the_cartesian_info() -> None:
    tcp, offset = (1.0, 2.0, 3.0, 0.1, 0.2, 0.3), (0.0, 0.0, 0.18, 0.0, 0.0, 0.5)
    state = package(4, struct.pack(">12d", *tcp, *offset))
    wire = package(20, b"version") + package(16, package(1, b"xx") + state)
    subject = PrimarySplitter()
    packages = [p for k in range(0, len(wire), 7) for p in subject.feed(wire[k : k + 7])]
    assert [kind for kind, _ in packages] == [20, 16]
    parts = dict(sub_packages(packages[1][1]))
    assert parse_tcp_offset(parts[4]) == offset


def test_kinematics_rows_come_as_theta_a_d_alpha() -> None:
    rows = [tuple(float(10 * r + k) for k in range(6)) for r in range(4)]
    body = (
        struct.pack(">6I", *range(6)) + b"".join(struct.pack(">6d", *r) for r in rows) + struct.pack(">I", 2)
    )
    subject = parse_kinematics(body)
    assert (subject.theta, subject.a, subject.d, subject.alpha) == tuple(rows)
    assert (subject.checksum, subject.status) == ((0, 1, 2, 3, 4, 5), 2)


def test_factory_deltas_are_the_difference_to_the_drawing() -> None:
    rows = [
        (1e-4, 0.0, 0.0, 0.0, 0.0, 0.0),
        (0.0, -0.6127 + 2e-4, -0.57155, 0.0, 0.0, 0.0),
        (0.1807, 0.0, 0.0, 0.17415, 0.11985 - 1e-4, 0.11655),
        (1.5707963267948966, 3e-4, 0.0, 1.5707963267948966, -1.5707963267948966, 0.0),
    ]
    body = struct.pack(">6I", *[0] * 6) + b"".join(struct.pack(">6d", *r) for r in rows)
    deltas = describe("ur10e", parse_kinematics(body))["calibration"]
    assert deltas["delta_theta"] == pytest.approx([1e-4, 0, 0, 0, 0, 0])
    assert deltas["delta_a"] == pytest.approx([0, 2e-4, 0, 0, 0, 0])
    assert deltas["delta_d"] == pytest.approx([0, 0, 0, 0, -1e-4, 0])
    assert deltas["delta_alpha"] == pytest.approx([0, 3e-4, 0, 0, 0, 0])


@pytest.mark.parametrize("wire", [struct.pack(">iB", 4, 16), struct.pack(">iB", 1 << 24, 16), b"\xff" * 8])
def test_an_impossible_primary_package_is_a_violation(wire: bytes) -> None:
    with pytest.raises(CellError) as caught:
        list(PrimarySplitter().feed(wire))
    assert caught.value.name == "PROTOCOL_VIOLATION"


def test_a_sub_package_longer_than_its_state_is_a_violation() -> None:
    with pytest.raises(CellError) as caught:
        list(sub_packages(struct.pack(">iB", 50, 4) + bytes(10)))
    assert caught.value.name == "PROTOCOL_VIOLATION"


@pytest.mark.parametrize(
    ("answer", "major", "name"),
    [
        ("UR10", 5, "ur10e"),
        ("UR10e", 5, "ur10e"),
        ("UR10", 3, "ur10"),
        ("UR20", 5, "ur20"),
        ("UR18", 5, "ur18"),
        ("UR8 LONG", 5, "ur8long"),
        ("UR3", 10, "ur3e"),
    ],
)
def test_an_e_series_model_gets_its_letter(answer: str, major: int, name: str) -> None:
    assert model_name(answer, major) == name


@pytest.mark.parametrize(
    ("said", "name"),
    [
        (
            "RuntimeError: One of the RTDE input registers are already in use! Currently",
            "ARM_REGISTER_CONFLICT",
        ),
        ("RuntimeError: ur_rtde: Please enable remote control on the robot!", "ARM_LOCAL_MODE"),
        ("RuntimeError: ur_rtde: Failed to start control script, before timeout of 5 seconds", "CHILD_DIED"),
    ],
)
def test_what_the_native_client_says_becomes_a_code(said: str, name: str) -> None:
    assert open_failure(error("CHILD_DIED", said)).name == name


def test_a_move_is_shortened_along_its_own_line_and_turn() -> None:
    start = from_pose6([0.4, 0.0, 0.5, 0.0, 0.0, 0.0])
    end = from_pose6([0.4, 0.0, 0.3, 0.0, 0.0, 0.8])
    subject = shortened(start, end, 0.05)
    np.testing.assert_allclose(to_pose6(subject), [0.4, 0.0, 0.45, 0.0, 0.0, 0.2], atol=1e-12)
    assert shortened(start, end, 0.3) is end


def test_unknown_config_keys_and_wrong_numbers_are_refused() -> None:
    with pytest.raises(ValidationError, match="hots"):
        UrConfig.model_validate({"host": "a", "hots": "b"})
    with pytest.raises(ValidationError, match="rtde_frequency_hz"):
        UrConfig.model_validate({"host": "a", "rtde_frequency_hz": 5000})
