"""A controller without sockets, whose time goes on only in control cycles."""

from collections.abc import Callable

import numpy as np

from cell.poses import Array
from fakes.ur.control_script import ControlProgram, ControlScript
from fakes.ur.dashboard import Dashboard
from fakes.ur.robot import ContactForce, Identity, Robot, no_contact
from fakes.ur.runtime import Program
from fakes.ur.scripting import ScriptPort
from fakes.world.arm.kinematics import chain
from fakes.world.arm.track import Track

HOME = np.array([0.0, -1.8, 1.8, -1.57, -1.57, 0.0])
CYCLE = 0.002
VERSION = (5, 12, 4, 1101534)


class Stepped:
    """A robot, its script port and its dashboard."""

    def __init__(
        self, version: tuple[int, int, int, int] = VERSION, contact: ContactForce = no_contact
    ) -> None:
        self.t = 100.0
        identity = Identity(version=version)
        self.robot = Robot(identity, Track(self.t, HOME), chain("ur10e"), lambda: self.t, contact)
        self.scripts = ScriptPort(self.robot)
        self.dashboard = Dashboard(self.robot)
        self.events: list[tuple[str, str, str]] = []
        self.messages: list[str] = []
        self.robot.on_message.append(self.messages.append)
        self.robot.on_program.append(
            lambda event, name, failure: self.events.append((event, name, failure.text if failure else ""))
        )

    def control(self) -> "Stepped":
        """With the control script running and ready."""
        steps = ControlProgram(self.robot, ControlScript(0, ())).steps()
        self.robot.start(Program("rtde_control", steps, "control"))
        self.until(lambda: self.out(0) == 1)
        return self

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / CYCLE)):
            self.t += CYCLE
            self.robot.step(self.t)

    def until(self, condition: Callable[[], bool], seconds: float = 20.0) -> None:
        end = self.t + seconds
        while not condition():
            assert self.t < end, "the condition did not come true"
            self.run(CYCLE)

    def command(self, number: int) -> None:
        """A command that the client waits for; its inputs were written before."""
        self.register(i0=number)
        self.until(lambda: self.out(0) == 2)
        self.register(i0=0)
        self.until(lambda: self.out(0) == 1)

    @property
    def q(self) -> Array:
        return self.robot.arm.track.at(self.t)[0]

    @property
    def tcp(self) -> Array:
        """The TCP pose in the base, (6,)."""
        return self.robot.arm.pose6(self.q)

    def register(self, **values: float) -> None:
        """Write input registers, ``i0=...`` and ``d3=...``."""
        kinds = {"i": "int", "d": "double"}
        for name, value in values.items():
            self.robot.registers[f"input_{kinds[name[0]]}_register_{name[1:]}"] = value

    def out(self, index: int) -> float:
        return self.robot.registers.get(f"output_int_register_{index}", 0)

    def doubles(self, count: int = 6, first: int = 0) -> Array:
        """Output double registers from ``first`` on."""
        names = (f"output_double_register_{first + k}" for k in range(count))
        return np.array([self.robot.registers.get(name, 0.0) for name in names])

    def vector(self, values: Array, first: int = 0) -> None:
        self.register(**{f"d{first + k}": float(v) for k, v in enumerate(values)})
