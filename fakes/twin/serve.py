"""The twin of a cell: one world, the fakes that show it on real protocols, and a ready cell.toml."""

import asyncio
import contextlib
import gc
import math
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cell.errors import error
from cell.poses import to_pose6
from fakes.faults.vocabulary import Switchboard, parse_fault
from fakes.twin.automatic_operator import AutomaticOperator
from fakes.twin.camera import TwinCamera
from fakes.twin.control import SOCKET_NAME, make_private, serve_control
from fakes.twin.device import TwinDevice
from fakes.twin.encoder import TwinEncoder
from fakes.twin.gripper import TwinGripper
from fakes.twin.inputs import TwinInputs
from fakes.twin.palletizer import TwinObserved
from fakes.twin.place_inputs import TwinPlaceInputs
from fakes.twin.tracker import TwinTracker
from fakes.ur import dashboard, primary, rtde
from fakes.ur.build import controller_for
from fakes.ur.controller import SCRIPT_PORT
from fakes.ur.injection import ControllerFaults
from fakes.ur.state import controller_state
from fakes.wire.lifetime import run_as_controller, settle_collector
from fakes.world.scenario import OBSERVED, Scenario
from fakes.world.world import World

MODBUS_PORT = 5020
UNIX_PATH_LIMIT = 107
COLLECT_S = 10.0  # the collector's turn, if the arm rests


@dataclass(frozen=True)
class TwinOptions:
    """What the command line decides."""

    scenario: str
    folder: Path
    bind: str | None = None
    automatic_operator: bool = False


class Twin:
    """``async with Twin(options)``: everything listens inside the block, nothing is left after it."""

    def __init__(self, options: TwinOptions) -> None:
        self.scenario = Scenario.load(options.scenario)
        self.folder = options.folder.absolute()
        self.bind = options.bind or self.scenario.fakes.bind
        self.frames_socket = self.folder / self.scenario.fakes.frames_socket
        if len(str(self.frames_socket)) > UNIX_PATH_LIMIT:
            raise error("ARGUMENT_INVALID", f"{self.frames_socket} is too long a path; use a shorter --out")
        self.world = World.from_scenario(self.scenario, time.monotonic())
        self.controller = controller_for(self.world, self.bind)
        self._arm_faults = ControllerFaults(self.controller)
        self.switchboard = Switchboard()
        self.switchboard.devices["arm"] = self._arm_faults
        self._devices = self._make_devices(options.scenario)
        self.switchboard.devices |= {name: device.faults for name, device in self._devices.items()}
        if options.automatic_operator or self.scenario.operator == "auto":
            self._operator = AutomaticOperator(self.controller.robot, self.world.operator)
        for fault in self.scenario.fault:
            device = self.switchboard.devices.get(fault.device)
            if device is None:
                raise error("CONFIG_INVALID", f"[[fault]] names {fault.device}, which the scenario has not")
            parse_fault(fault.kind, device.offers(), fault.device)
        self._control: asyncio.Server | None = None
        self._timers: list[asyncio.TimerHandle] = []

    def _make_devices(self, scenario: str) -> dict[str, TwinDevice]:
        """The devices that this world has, in the order in which they start."""
        world, where = self.world, (self.scenario.fakes, self.bind, self.folder)
        devices: dict[str, TwinDevice] = {}
        if world.inputs is not None:
            devices["beams"] = TwinInputs(world.inputs, *where, self.controller.ticker.catch_up)
        if world.encoder is not None:
            devices["belt"] = TwinEncoder(world.encoder, *where)
        if world.observed is not None:
            devices[OBSERVED] = TwinObserved(world.observed, *where)
        if world.gripper is not None and self.scenario.fakes.gripper_by != "arm":
            devices["gripper"] = TwinGripper(world.gripper, *where)
        if world.place is not None:
            devices["place_inputs"] = TwinPlaceInputs(world.place, *where, self.controller.ticker.catch_up)
        if world.tracker is not None:
            devices["tracker"] = TwinTracker(world.tracker, *where)
        if self.scenario.world.camera is not None:  # last: it draws as soon as it listens
            devices["camera"] = TwinCamera(self.frames_socket, scenario, world)
        return devices

    def fork_camera(self) -> None:
        """Make the camera's process beforehand, as a copy of a program that begins."""
        if isinstance(camera := self._devices.get("camera"), TwinCamera):
            camera.fork()

    async def __aenter__(self) -> "Twin":
        self.world.truth(self.controller.now())  # what it needs is made before anything keeps time
        make_private(self.folder)
        self._control = await serve_control(self.folder, self._handle)
        self.cell_toml.unlink(missing_ok=True)  # whoever waits for it must not find an old one
        try:
            await self._start_devices()
        except BaseException:
            await self.__aexit__()
            raise
        self._write_cell_toml()
        loop = asyncio.get_running_loop()
        for fault in self.scenario.fault:
            self._timers.append(
                loop.call_later(fault.when_s, self.switchboard.inject, fault.device, fault.kind, fault.args)
            )
        return self

    async def __aexit__(self, *_: object) -> None:
        for timer in self._timers:
            timer.cancel()
        self._arm_faults.close()
        for device in self._devices.values():
            await device.stop()
        await self.controller.stop()
        if self._control is not None:
            self._control.close()
        (self.folder / SOCKET_NAME).unlink(missing_ok=True)

    @property
    def cell_toml(self) -> Path:
        """The configuration with which a daemon finds this twin."""
        return self.folder / "cell.toml"

    def addresses(self) -> dict[str, str]:
        """What listens where, by name."""
        ports = {
            "RTDE": rtde.PORT,
            "dashboard": dashboard.PORT,
            "script": SCRIPT_PORT,
            "primary": primary.PORT,
        }
        found = {f"arm {name}": f"{self.bind}:{port}" for name, port in ports.items()}
        for device in self._devices.values():
            found |= device.addresses()
        return found

    def truth(self) -> dict[str, Any]:
        """The world's truth and the arm's state now."""
        now = self.controller.now()
        return {
            **self.world.truth(now),
            "placement": self.world.operator.placement_at(now),
            "arm": controller_state(self.controller),
        }

    async def _start_devices(self) -> None:
        try:
            await self.controller.start()
            for device in self._devices.values():
                await device.start()
        except OSError as exc:
            raise error("DEVICE_UNREACHABLE", f"the twin cannot listen on {self.bind}: {exc}") from exc

    # -- requests of the control socket

    async def _handle(self, request: dict[str, Any]) -> Any:
        match request:
            case {"do": "fault", "device": str(device), "kind": str(kind), "args": dict(args)}:
                self.switchboard.inject(device, kind, args)
                return None
            case {"do": "faults"}:
                return {name: sorted(d.offers()) for name, d in self.switchboard.devices.items()}
            case {"do": "truth"}:
                return self.truth()
            case {"do": "operator", "block": True}:
                if self.world.place is None:
                    raise error("ARGUMENT_INVALID", "this twin's scenario has no [world.place]")
                self.world.place.block(self.controller.now())
                return self.world.place.truth.carried_off_s
            case {"do": "operator"} if "camera" not in self._devices:
                raise error("ARGUMENT_INVALID", "this twin's scenario has no target that could be moved")
            case {"do": "operator", "place": int(number)}:
                # People count placements from one.
                self.world.operator.confirm(number - 1, self.controller.now())
                return number
            case {"do": "operator", "next": True}:
                return self.world.operator.move_on(self.controller.now()) + 1
            case {"do": "operator", "over": int(point), "gauge_m": float(gauge), "hand_m": float(hand)}:
                now = self.controller.now()
                return self.world.bring_over(now, point, gauge, hand) - now
            case {"do": "operator", "remove": True}:
                self.world.operator.remove(self.controller.now())
                return None
            case {"do": "gripper", "empty": True}:
                if self.world.gripper is None:
                    raise error("ARGUMENT_INVALID", "this twin's scenario has no gripper")
                return self.world.gripper.empty(self.controller.now())
            case {"do": "observed", "go": [*q]} if all(map(_is_finite, q)):
                return self._jog([float(x) for x in q])
            case {"do": "tool", "bend": [*values]} if len(values) == 6 and all(map(_is_finite, values)):
                self.world.tool.bend(self.controller.now(), values[:3], values[3:])
                return to_pose6(self.world.T_flange_tool_at(self.controller.now())).tolist()
            case {"do": "tracker", "lock": str(reflector)}:
                tracker = self._devices.get("tracker")
                if not isinstance(tracker, TwinTracker):
                    raise error("ARGUMENT_INVALID", "this twin's scenario has no tracker")
                tracker.lock(reflector)
                return None
            case {"do": "tool", "straighten": True}:
                self.world.tool.straighten(self.controller.now())
                return to_pose6(self.world.T_flange_tool_at(self.controller.now())).tolist()
            case _:
                raise error("ARGUMENT_INVALID", f"a twin does not know the request {str(request)[:100]}")

    def _jog(self, q: list[float]) -> float:
        """Somebody at the pendant moves the observed arm; returns in how many seconds it rests there."""
        arm = self.world.observed
        if arm is None:
            raise error("ARGUMENT_INVALID", "this twin's scenario has no observed arm")
        if not arm.within(q):
            raise error("ARGUMENT_INVALID", f"{q} is not within the arm's limits {arm.truth.limits}")
        now = time.monotonic()
        return arm.go(now, q) - now

    def _write_cell_toml(self) -> None:
        self.scenario.write_robots(self.folder)
        draft = self.cell_toml.with_suffix(".new")
        draft.write_text(self._config_text(), "utf-8")
        draft.rename(self.cell_toml)

    def _config_text(self) -> str:
        return self.scenario.cell_toml(
            {"arm": {"driver": "ur", "host": self.bind}}
            | {name: device.device() for name, device in self._devices.items()}
            | self._gripper_device(),
            state_dir=str(self.folder / "state"),
            control_socket=str(self.folder / "cellward.sock"),
            modbus={
                "bind": f"{self.bind}:{MODBUS_PORT}",
                "allow_write": True,
                "allow_clients": ["127.0.0.1"],
                "allow_accept": True,
            },
        )

    def _gripper_device(self) -> dict[str, dict[str, Any]]:
        """Without a link of its own an output of the arm closes it."""
        if self.world.gripper is None or "gripper" in self._devices:
            return {}
        truth = self.world.gripper.truth
        wired = truth.model_dump(include={"output", "open_output", "confirm"}, exclude_none=True)
        table = {"driver": "arm-gripper", "arm": "arm", **wired}
        if truth.confirm is None:
            table["moves_s"] = 1.2 * max(truth.close_s, truth.open_s)
        return {"gripper": table}


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def serve(options: TwinOptions, ready: Callable[[Twin], None]) -> None:
    """Run a twin until SIGINT or SIGTERM; ``ready`` is called when everything listens."""
    twin = Twin(options)
    settle_collector()
    twin.fork_camera()
    asyncio.run(_until_signal(twin, ready))


async def _until_signal(twin: Twin, ready: Callable[[Twin], None]) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    run_as_controller()  # not before: making a world takes a second of a core
    async with twin:
        ready(twin)
        while not stop.is_set():
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(stop.wait(), COLLECT_S)
            if not twin.controller.robot.arm.moving(twin.controller.now()):
                gc.collect()
