"""The fake controller against the RTDE guide: any client that follows the protocol is served."""

import socket
import struct
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from fake_ur_client import Lines, Rtde, Text

from fakes.ur.process import ControllerHandle, running_controller

pytestmark = pytest.mark.wire
HOST = "127.0.0.5"
INT0 = "input_int_register_0"


@pytest.fixture(scope="module")
def subject() -> Iterator[ControllerHandle]:
    with running_controller(HOST) as controller:
        yield controller


@pytest.fixture(autouse=True)
def _behaves(subject: ControllerHandle) -> Iterator[None]:
    yield
    subject.inject("clear")


class Cadence:
    """Every stamp is there but for those of cycles for which this machine gave the controller no core."""

    def __init__(self, controller: ControllerHandle, step_s: float) -> None:
        self._controller, self._step_s = controller, step_s
        self._lost = controller.truth()["lost_cycles"]

    def check(self, stamps: np.ndarray) -> None:
        steps = np.diff(stamps) / self._step_s
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
        assert np.min(np.round(steps)) == 1.0
        lost = self._controller.truth()["lost_cycles"] - self._lost
        assert np.sum(np.round(steps) - 1.0) <= np.ceil(lost * 0.002 / self._step_s)


def test_version_two_is_accepted_and_version_three_is_not(subject: ControllerHandle) -> None:
    with Rtde(HOST) as link:
        assert link.ask("V", struct.pack(">H", 3)) == b"\x00"
        assert struct.unpack(">4I", link.ask("v"))[:3] == (5, 12, 4)


def test_stamps_advance_by_exactly_one_cycle(subject: ControllerHandle) -> None:
    cadence = Cadence(subject, 0.002)
    with Rtde(HOST) as link:
        assert link.outputs("timestamp,actual_q,") == "DOUBLE,VECTOR6D"
        assert link.start()
        stamps = np.array([link.doubles()[0] for _ in range(250)])
    cadence.check(stamps)


def test_a_lower_frequency_is_a_divisor_of_the_cycle(subject: ControllerHandle) -> None:
    cadence = Cadence(subject, 0.01)
    with Rtde(HOST) as link:
        link.outputs("timestamp", 100.0)
        assert link.start()
        stamps = np.array([link.doubles()[0] for _ in range(30)])
    cadence.check(stamps)


def test_protocol_one_has_no_recipe_id_and_125_hz(subject: ControllerHandle) -> None:
    cadence = Cadence(subject, 0.008)
    with Rtde(HOST, version=1) as link:
        assert link.outputs("timestamp,actual_TCP_pose") == "DOUBLE,VECTOR6D"
        assert link.start()
        packages = np.array([link.doubles() for _ in range(20)])
    assert packages.shape == (20, 7)
    cadence.check(packages[:, 0])


@pytest.mark.parametrize("name", ["no_such_variable", "actual_current_as_torque"])
def test_an_unknown_variable_is_not_found_and_spoils_only_its_recipe(
    subject: ControllerHandle, name: str
) -> None:
    with Rtde(HOST) as link:
        assert link.outputs(f"timestamp,{name}") == "DOUBLE,NOT_FOUND"
        assert not link.start()
        assert link.outputs("timestamp") == "DOUBLE"
        assert link.start()
        assert len(link.doubles()) == 1


def test_input_recipes_count_from_one_and_bad_ones_get_none(subject: ControllerHandle) -> None:
    with Rtde(HOST) as link:
        assert link.inputs(f"{INT0},input_double_register_0") == (1, "INT32,DOUBLE")
        assert link.inputs("no_such_register") == (0, "NOT_FOUND")
        assert link.inputs("input_int_register_1") == (2, "INT32")


def test_an_owned_register_is_in_use_until_its_owner_goes(subject: ControllerHandle) -> None:
    with Rtde(HOST) as owner, Rtde(HOST) as second:
        assert owner.inputs(INT0)[0] == 1
        assert owner.inputs(f"{INT0},input_int_register_1")[0] == 2
        assert second.inputs(f"{INT0},input_int_register_2") == (0, "IN_USE,INT32")
    with Rtde(HOST) as third:
        assert _eventually(lambda: third.inputs(INT0)[1] == "INT32")


def test_a_written_register_comes_back_to_every_client(subject: ControllerHandle) -> None:
    with Rtde(HOST) as writer, Rtde(HOST) as reader:
        recipe, _ = writer.inputs("input_int_register_7,input_double_register_7")
        reader.outputs("input_int_register_7,input_double_register_7")
        reader.start()
        writer.send("U", struct.pack(">Bid", recipe, -42, 2.5))
        assert _eventually(lambda: reader.value("id") == (-42, 2.5))


def test_a_masked_output_changes_only_the_bits_of_its_mask(subject: ControllerHandle) -> None:
    with Rtde(HOST) as link:
        recipe, types = link.inputs("standard_digital_output_mask,standard_digital_output")
        assert types == "UINT8,UINT8"
        link.outputs("actual_digital_output_bits")
        link.start()
        link.send("U", struct.pack(">BBB", recipe, 0b0110, 0b0110))
        link.send("U", struct.pack(">BBB", recipe, 0b0011, 0b0001))
        assert _eventually(lambda: link.value("Q")[0] & 0xFF == 0b0101)


def test_pause_ends_the_stream_and_start_resumes_it(subject: ControllerHandle) -> None:
    with Rtde(HOST) as link:
        link.outputs("timestamp")
        link.start()
        before = link.doubles()[0]
        assert link.ask("P") == b"\x01"
        link.send("v")
        assert link.receive()[0] == "v"
        assert link.start()
        assert link.doubles()[0] > before


def test_packages_in_pieces_and_several_at_once_are_understood(subject: ControllerHandle) -> None:
    with Rtde(HOST) as link:
        request = struct.pack(">HB", 3, ord("v"))
        for byte in request:
            link.raw(bytes([byte]))
            time.sleep(0.005)
        assert link.receive()[0] == "v"
        link.raw(request * 5)
        assert [link.receive()[0] for _ in range(5)] == ["v"] * 5


def test_unknown_packages_are_passed_over(subject: ControllerHandle) -> None:
    with Rtde(HOST) as link:
        link.send("?", b"who knows")
        link.send("v")
        assert link.receive()[0] == "v"


@pytest.mark.parametrize("payload", [b"", b"\x09", b"\x01\x00"], ids=["empty", "unknown recipe", "short"])
def test_a_malformed_data_package_is_answered_with_a_message(
    subject: ControllerHandle, payload: bytes
) -> None:
    with Rtde(HOST) as link:
        link.inputs("input_double_register_3")
        link.send("U", payload)
        kind, body = link.receive()
        assert kind == "M"
        text = body[1 : 1 + body[0]].decode()
        assert "recipe" in text


def test_junk_ends_only_the_connection_that_sent_it(subject: ControllerHandle) -> None:
    with Rtde(HOST) as good, Rtde(HOST) as bad:
        good.outputs("timestamp")
        good.start()
        bad.raw(b"\x00\x01\x00" * 10)
        with pytest.raises(ConnectionError):
            bad.next("v")
        assert len(good.doubles()) == 1


def test_a_client_that_does_not_read_is_dropped_and_others_keep_their_rate(
    subject: ControllerHandle,
) -> None:
    names = "timestamp," + ",".join(f"output_double_register_{k}" for k in range(48))
    with Rtde(HOST) as good, socket.socket() as lazy:
        lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        lazy.connect((HOST, 30004))
        wish = struct.pack(">d", 500.0) + names.encode()
        lazy.sendall(struct.pack(">HBH", 5, ord("V"), 2))
        lazy.sendall(struct.pack(">HB", 3 + len(wish), ord("O")) + wish)
        lazy.sendall(struct.pack(">HB", 3, ord("S")))
        good.outputs("timestamp")
        cadence = Cadence(subject, 0.002)
        good.start()
        stamps = [good.doubles()[0]]
        deadline = time.monotonic() + 15.0
        while subject.truth()["rtde_clients"] > 1 and time.monotonic() < deadline:
            stamps += [good.doubles()[0] for _ in range(50)]
        assert subject.truth()["rtde_clients"] == 1
    cadence.check(np.array(stamps))


def test_ten_clients_with_recipes_of_their_own_are_served(subject: ControllerHandle) -> None:
    links = [Rtde(HOST) for _ in range(10)]
    try:
        for k, link in enumerate(links):
            assert link.outputs(",".join(["timestamp"] * (k + 1))) == ",".join(["DOUBLE"] * (k + 1))
            link.start()
        for k, link in enumerate(links):
            values = link.doubles()
            assert len(values) == k + 1
            assert len(set(values)) == 1
    finally:
        for link in links:
            link.__exit__()


# -- dashboard and primary


def test_the_dashboard_greets_and_knows_what_it_does_not_understand(subject: ControllerHandle) -> None:
    with Lines(HOST) as dashboard:
        assert dashboard.banner == "Connected: Universal Robots Dashboard Server"
        assert dashboard.ask("ROBOTMODE") == "Robotmode: RUNNING"
        assert dashboard.ask("make coffee").startswith("could not understand")
        assert dashboard.ask("get serial number").isdigit()
        assert dashboard.ask("load picks.urp") == "Loading program: picks.urp"
        assert dashboard.ask("load picks.txt") == "File not found: picks.txt"


def test_the_primary_port_says_version_first_and_then_its_state(subject: ControllerHandle) -> None:
    with Text(HOST) as primary:
        kind, body = next(primary.packages())
        assert (kind, body[9]) == (20, 3)
        name = body[11 : 11 + body[10]]
        assert name == b"URControl"
        assert tuple(body[11 + len(name) : 13 + len(name)]) == (5, 12)
        state = primary.state()
    assert set(state) == {0, 1, 3, 4, 5, 6}
    assert {k: len(v) for k, v in state.items()} == {0: 42, 1: 246, 3: 70, 4: 96, 5: 220, 6: 440}
    theta, a, d, alpha = np.array(struct.unpack(">6I24dI", state[5])[6:30]).reshape(4, 6)
    # Universal Robots' published DH parameters of the UR10e.
    np.testing.assert_allclose(theta, 0.0)
    np.testing.assert_allclose(a, [0, -0.6127, -0.57155, 0, 0, 0])
    np.testing.assert_allclose(d, [0.1807, 0, 0, 0.17415, 0.11985, 0.11655])
    np.testing.assert_allclose(alpha, np.array([1, 0, 0, 1, -1, 0]) * np.pi / 2)


def test_the_primary_state_carries_pose_and_tool_offset(subject: ControllerHandle) -> None:
    offset = (0.01, 0.02, 0.15, 0.0, 0.0, 0.5)
    with Text(HOST) as primary, Rtde(HOST) as link:
        primary.send(f"set_tcp(p[{','.join(map(str, offset))}])\n")
        assert _eventually(
            lambda: np.allclose(struct.unpack(">12d", primary.state()[4])[6:], offset, atol=1e-12)
        )
        link.outputs("actual_TCP_pose")
        link.start()
        pose = struct.unpack(">12d", primary.state()[4])[:6]
        np.testing.assert_allclose(pose, link.doubles(), atol=1e-12)


def _eventually(condition: Callable[[], bool], timeout: float = 3.0) -> bool:
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.005)
    return True
