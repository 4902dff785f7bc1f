"""An encoder on CAN on the twin's switchboard: faults of its wires and its node, and those of its shaft."""

import asyncio

from cell.errors import error
from fakes.can.bus import Frame
from fakes.can.wires import CanWires
from fakes.faults.actions import Action, Actions, Arguments, amount, switch
from fakes.faults.vocabulary import MAX_ARGUMENT, Fault, Faulty, number

_DROP_S = 0.2  # an adapter that was pulled out is there again after so long
_GENERIC = 0x1000
_ELSEWHERE = 5000  # counts by which another encoder stands elsewhere


class CanFaults:
    """Injects faults into one encoder; lasting ones end after ``for_s`` seconds or with ``clear``.

    ``shaft`` shows the faults of the belt and of the encoder's wheel. ``drop`` and ``refuse`` pull the
    serial adapter out and close the gateway's connections.
    """

    def __init__(self, wires: CanWires, shaft: Faulty | None = None) -> None:
        self._wires, self._shaft = wires, shaft
        self._back: asyncio.TimerHandle | None = None
        self._listening: asyncio.Task[None] | None = None
        link, node, bus = wires.link_faults, wires.node, wires.bus
        self._actions = Actions(
            {
                Fault.REFUSE: Action(self._refuse, self._welcome),
                Fault.DROP: Action(self._drop),
                Fault.HALF_OPEN: switch(link, "half_open"),
                Fault.SILENCE: switch(node, "silent"),
                Fault.DELAY: amount(link, "delay_s", 0.05),
                Fault.SPLIT: switch(link, "split"),
                Fault.JUNK: Action(self._junk),
                Fault.DUPLICATE: switch(bus.faults, "duplicate"),
                Fault.GAP: Action(self._lose, takes=frozenset({"count"})),
                Fault.CLOCK_JUMP: Action(self._jump, takes=frozenset({"s"})),
                Fault.UNPLUG: Action(lambda a: node.power_off(), self._plug_in),
                Fault.BUS_OFF: Action(lambda a: bus.switch_off(True), lambda: bus.switch_off(False)),
                Fault.NODE_STOP: Action(self._stop_node),
                Fault.SECOND_SENDER: Action(self._join_second, self._end_second, frozenset({"counts"})),
                Fault.ALARM: Action(self._alarm, lambda: node.alarm(0, 0), frozenset({"code", "register"})),
                Fault.REBOOT: Action(self._reboot, takes=frozenset({"boot_s", "serial"})),
            }
        )
        self._other_master = bus.join(lambda frame, t: None).send
        self._ahead: int | None = None  # of the second sender, where there is one
        self._second = bus.join(self._answer_position).send

    def offers(self) -> frozenset[Fault]:
        """The faults of the wires, the node and the shaft."""
        return self._actions.offers() | (self._shaft.offers() if self._shaft else frozenset())

    def inject(self, fault: Fault, arguments: Arguments) -> None:
        """Begin ``fault``; ``for_s`` ends it by itself. ``ARGUMENT_INVALID`` for what it does not take."""
        if fault in self._actions.offers():
            self._actions.inject(fault, arguments)
        elif self._shaft is not None:
            self._shaft.inject(fault, arguments)

    def clear(self) -> None:
        """End every fault that lasts."""
        self._actions.end_all()
        if self._shaft is not None:
            self._shaft.clear()

    def close(self) -> None:
        """Forget timers."""
        self._actions.forget_timers()
        if self._back is not None:
            self._back.cancel()
        if self._listening is not None:
            self._listening.cancel()

    def _refuse(self, arguments: Arguments) -> None:
        if self._back is not None:
            self._back.cancel()
        if self._wires.adapter is not None:
            self._wires.adapter.pull_out()
        if self._wires.gateway is not None:
            self._wires.gateway.refuse()

    def _welcome(self) -> None:
        adapter, gateway = self._wires.adapter, self._wires.gateway
        if adapter is not None and not adapter.path.is_symlink():
            adapter.plug_in()
        if gateway is not None:
            self._listening = asyncio.get_running_loop().create_task(gateway.listen())

    def _drop(self, arguments: Arguments) -> None:
        if self._wires.gateway is not None:
            self._wires.gateway.cut()
        if self._wires.adapter is not None:
            self._wires.adapter.pull_out()
            self._back = asyncio.get_running_loop().call_later(_DROP_S, self._welcome)

    def _junk(self, arguments: Arguments) -> None:
        if self._wires.adapter is not None:
            self._wires.adapter.junk()
        if self._wires.gateway is not None:
            self._wires.gateway.junk()

    def _lose(self, arguments: Arguments) -> None:
        self._wires.bus.faults.lose[self._wires.node.position_id] = int(number(arguments, "count", 10, low=1))

    def _jump(self, arguments: Arguments) -> None:
        if self._wires.gateway is None:
            raise error("ARGUMENT_INVALID", "a serial adapter has no clock that could jump")
        self._wires.gateway.clock_ahead_s += number(arguments, "s", 10.0, low=-MAX_ARGUMENT)

    def _plug_in(self) -> None:
        if self._wires.node.state < 0:
            self._wires.node.power_on()

    def _stop_node(self, arguments: Arguments) -> None:
        node = self._wires.node
        self._other_master(Frame(0, bytes([2, node.number])), asyncio.get_running_loop().time())

    def _join_second(self, arguments: Arguments) -> None:
        self._ahead = int(number(arguments, "counts", _ELSEWHERE, low=1))

    def _end_second(self) -> None:
        self._ahead = None

    def _answer_position(self, frame: Frame, t: float) -> None:
        """Another encoder has the same identifier and timer, and stands elsewhere."""
        node = self._wires.node
        if self._ahead is None or frame.id != node.position_id or len(frame.data) < 4:
            return
        there = (int.from_bytes(frame.data[:4], "little") + self._ahead) % node.shaft.modulus
        self._second(Frame(frame.id, there.to_bytes(4, "little") + frame.data[4:]), t)

    def _alarm(self, arguments: Arguments) -> None:
        code = int(number(arguments, "code", _GENERIC, low=1))
        register = int(number(arguments, "register", 1, low=1))
        if code > 0xFFFF or register > 0xFF:
            raise error("ARGUMENT_INVALID", "code has 16 bits and register 8")
        self._wires.node.alarm(code, register)

    def _reboot(self, arguments: Arguments) -> None:
        serial = str(arguments.get("serial", self._wires.node.serial))
        if not serial.isdigit() or not serial.startswith("9999") or int(serial) > 0xFFFF_FFFF:
            raise error(
                "ARGUMENT_INVALID",
                f"serial={serial!r}: twin serials are digits that begin with 9999, of 32 bits here",
            )
        self._wires.node.serial = int(serial)
        self._wires.node.restart(number(arguments, "boot_s", 0.05))
