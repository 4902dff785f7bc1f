"""From data packages to ``ArmState`` samples: decoding, stamps on our clock, numbering, safety."""

import struct
from collections.abc import Sequence

import numpy as np

from cell.clock import Clock, ClockModel
from cell.devices import ArmState
from cell.errors import error
from cell.poses import Array
from cell.samples import Sample, Stream
from drivers.ur.rtde import Recipe
from drivers.ur.safety import ROBOT_RUNNING, SafetyFinding, safety_finding

# Doubles first, so that one conversion reads them all.
_DOUBLES = (
    "timestamp",
    "actual_q",
    "actual_qd",
    "actual_TCP_pose",
    "actual_TCP_force",
    "target_speed_fraction",
    "speed_scaling",
)
_WORDS = (
    "robot_mode",
    "safety_mode",
    "safety_status_bits",
    "runtime_state",
    "actual_digital_input_bits",
    "actual_digital_output_bits",
)
_TYPES = {
    "timestamp": "DOUBLE",
    "target_speed_fraction": "DOUBLE",
    "speed_scaling": "DOUBLE",
    "payload": "DOUBLE",
    "payload_cog": "VECTOR3D",
    "robot_mode": "INT32",
    "safety_mode": "INT32",
    "safety_status_bits": "UINT32",
    "runtime_state": "UINT32",
    "actual_digital_input_bits": "UINT64",
    "actual_digital_output_bits": "UINT64",
}
_WIDTHS = {"DOUBLE": 1, "VECTOR3D": 3, "VECTOR6D": 6}
_WORDS_LAYOUT = struct.Struct(">iiIIQQ")

# Newer controllers put these into every package; older ones tell the TCP on the primary port only.
_OPTIONAL = ("payload", "payload_cog", "tcp_offset")

NAMES = (*_DOUBLES, *_OPTIONAL, *_WORDS)

STOPPING, STOPPED, PLAYING = 0, 1, 2
REBOOT_STEP_S = 1.0


class StateFeed:
    """Turns each package into a sample of ``stream`` and remembers what only the driver needs.

    ``runtime_state``, ``speed_fraction`` and ``finding`` (the error of the newest package) are of the
    newest package, and so is ``payload`` (mass in kg, centre of mass in m) where the controller tells it.
    ``tcp_offset6`` has to be set before the first package.
    """

    def __init__(self, stream: Stream[ArmState], clock: Clock, time_offset_s: float) -> None:
        self.stream = stream
        self.tcp_offset6: Array = np.zeros(6)
        self.runtime_state = STOPPED
        self.speed_fraction = 1.0
        self.payload: tuple[float, Array] | None = None
        self.finding: SafetyFinding | None = None
        self.repeated = 0
        self.reboots = 0
        self._clock, self._time_offset_s = clock, time_offset_s
        self._frequency_hz = 0.0
        self._model = ClockModel()
        self._size = 0
        self._recipe_id = -1
        self._doubles = 0
        self._places: dict[str, slice] = {}
        self._origin: float | None = None
        self._stamp = -np.inf
        self._offset = np.nan  # arrival minus stamp of the newest package
        self._seq = 0
        self._t = -np.inf
        self._fresh = -np.inf
        self._modes = (0, 0, 0)
        self._rebooted = False

    def begin(self, recipe: Recipe, frequency_hz: float) -> None:
        """A new connection with this recipe and rate: new epoch, new clock model."""
        expected = tuple(_TYPES.get(name, "VECTOR6D") for name in recipe.names)
        if recipe.types != expected:
            wrong = [f"{n} {t}" for n, t in zip(recipe.names, recipe.types, strict=True) if t != _wanted(n)]
            raise error("PROTOCOL_VIOLATION", f"the controller has no such variables: {', '.join(wrong)}")
        self._frequency_hz = frequency_hz
        self._recipe_id, self._size = recipe.id, 1 + recipe.layout.size
        self._places = _places(recipe)
        self._doubles = sum(_WIDTHS.get(t, 0) for t in recipe.types)
        self._model = ClockModel()
        self._origin = None
        self._t = self._fresh = -np.inf
        self.payload = None
        self.stream.new_epoch()

    def set_tcp(self, offset6: Sequence[float] | Array) -> None:
        """The active TCP was read back; a change starts a new epoch: older flange poses do not compare."""
        if np.array_equal(offset6, self.tcp_offset6):
            return
        offset = np.array(offset6, dtype=float)
        if not np.allclose(offset, self.tcp_offset6, rtol=0.0, atol=1e-9):
            self.tcp_offset6 = offset
            self.stream.new_epoch()

    def take(self, payload: bytes, arrival: float) -> None:
        """Decode one package and push its sample; ``PROTOCOL_VIOLATION`` or ``ARM_REBOOTED`` end the link."""
        if len(payload) != self._size or payload[0] != self._recipe_id:
            raise error("PROTOCOL_VIOLATION", f"data package of {len(payload)} bytes, expected {self._size}")
        block = np.frombuffer(payload, ">f8", self._doubles, 1).astype(np.float64)
        if not np.isfinite(block).all():
            raise error("PROTOCOL_VIOLATION", "data package with numbers that are not finite")
        stamp = float(block[0])
        if self._origin is None:
            self._note_reboot(stamp, arrival)
        elif stamp <= self._stamp:
            self._refuse_step_back(stamp)
            self.repeated += 1
            return
        words = _WORDS_LAYOUT.unpack_from(payload, 1 + 8 * self._doubles)
        self._judge(words[0], words[1], words[2])
        self.runtime_state = words[3]
        self.speed_fraction = float(block[25])
        if (place := self._places.get("tcp_offset")) is not None:
            self.set_tcp(block[place])
        if (place := self._places.get("payload_cog")) is not None:
            self.payload = float(block[place.start - 1]), block[place]
        self._push(stamp, arrival, block, words)

    def silence(self) -> float:
        """Seconds since the newest package was made; infinite before the first of a connection."""
        return self._clock.now() - self._fresh

    def _note_reboot(self, stamp: float, arrival: float) -> None:
        """The controller counts from its start: a later origin than in the last connection is a new start."""
        step = (arrival - stamp) - self._offset
        if step > REBOOT_STEP_S:  # never so for the first connection, where the old offset is not a number
            self.reboots += 1
            self._rebooted = True

    def _refuse_step_back(self, stamp: float) -> None:
        if self._stamp - stamp > REBOOT_STEP_S:
            self._origin = None
            raise error(
                "ARM_REBOOTED", f"the controller's clock went from {self._stamp:.3f} s to {stamp:.3f} s"
            )

    def _judge(self, robot_mode: int, safety_mode: int, bits: int) -> None:
        modes = (robot_mode, safety_mode, bits)
        if modes == self._modes and not self._rebooted:
            return
        self._modes = modes
        finding = safety_finding(*modes)
        if self._rebooted and finding is not None and finding.name == "ARM_NOT_READY":
            finding = SafetyFinding("ARM_REBOOTED", finding.detail)
        self._rebooted = self._rebooted and robot_mode != ROBOT_RUNNING
        if finding != self.finding:
            self.finding = finding

    def _push(self, stamp: float, arrival: float, block: Array, words: tuple[int, ...]) -> None:
        self._fresh = self._model.observe(stamp, arrival)
        if self._origin is None:
            self._origin, self._seq = stamp, 0
        else:
            number = round((stamp - self._origin) * self._frequency_hz)
            self._seq = max(number, self._seq + 1)
        # The envelope may settle by more than a period right after a connect; order is kept.
        self._t = t = max(self._fresh - self._time_offset_s, self._t)
        self._stamp, self._offset = stamp, arrival - stamp
        state = ArmState(
            q=block[1:7],
            qd=block[7:13],
            tcp_pose6=block[13:19],
            tcp_force=block[19:25],
            tcp_offset6=self.tcp_offset6,
            robot_mode=words[0],
            safety_mode=words[1],
            program_running=words[3] == PLAYING,
            digital_in=words[4],
            digital_out=words[5],
            stamp=stamp,
            speed_scaling=self._scaling(float(block[26]), words[3]),
        )
        self.stream.push(Sample(state, t, 0.5 / self._frequency_hz, self._seq))

    def _scaling(self, limiter: float, runtime_state: int) -> float:
        """What the slider leaves, and the limiter of the program that runs: without one it says nothing."""
        return min(self.speed_fraction, limiter) if runtime_state == PLAYING else self.speed_fraction


def available(recipe: Recipe) -> tuple[str, ...]:
    """The names to ask for again, without the optional ones that this controller does not have."""
    missing = {n for n, t in zip(recipe.names, recipe.types, strict=True) if t == "NOT_FOUND"}
    if {"payload", "payload_cog"} & missing:
        missing |= {"payload", "payload_cog"}
    return tuple(n for n in recipe.names if n not in missing or n not in _OPTIONAL)


def _places(recipe: Recipe) -> dict[str, slice]:
    """Where each vector or double lies in the block of doubles at the front of a package."""
    places, at = {}, 0
    for name, type_ in zip(recipe.names, recipe.types, strict=True):
        if type_ in _WIDTHS:
            places[name] = slice(at, at + _WIDTHS[type_])
            at += _WIDTHS[type_]
    return places


def _wanted(name: str) -> str:
    return _TYPES.get(name, "VECTOR6D")
