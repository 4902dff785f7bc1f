"""Builds a controller from a scenario's world, or a plain one."""

import time
from collections.abc import Mapping
from typing import Any

from cell.errors import error
from fakes.ur.controller import Controller
from fakes.ur.robot import Identity
from fakes.world.arm.ripple import Ripple
from fakes.world.arm.servo import Servo
from fakes.world.scenario import Scenario
from fakes.world.world import World

BUILD_NUMBER = 1101534


def parse_version(text: str) -> tuple[int, int, int, int]:
    """``5.12.4`` or ``5.12.4.1101534``; a missing build number is filled in."""
    parts = [int(part) for part in text.split(".")]
    major, minor, bugfix, build = (*parts, 0, 0, 0)[:4]
    return major, minor, bugfix, build or BUILD_NUMBER


def controller_for(world: World, bind: str) -> Controller:
    """The controller of the arm in ``world``."""
    arm = world.config.arm
    if arm.robot is not None:
        raise error(
            "CONFIG_INVALID",
            f"world.arm.robot: {arm.name} is no arm of UR, and the twin on real protocols speaks as one; "
            "its world runs on the object face, without protocols",
        )
    try:
        fastest = arm.controller_limits.reached(arm.model)
    except ValueError as exc:
        raise error("CONFIG_INVALID", str(exc)) from None
    version, deltas = parse_version(arm.version), arm.factory.deltas()
    identity = Identity(arm.model, arm.serial, version, deltas, arm.controller_limits)
    ripple = Ripple.of(arm.servo, world.config.seed)
    made = Controller(
        bind,
        identity,
        world.track,
        world.believed,
        world.contact_force,
        digital_in=world.arm_digital_in,
        servo=None if arm.servo.lag == "none" else Servo(arm.servo, fastest, ripple),
        reported=world.reported,
    )
    made.robot.io.listeners.append(lambda word: world.set_arm_output(made.now(), word))
    return made


def build_controller(bind: str, scenario: Scenario | None, settings: Mapping[str, Any]) -> Controller:
    """A controller on ``bind``; ``settings`` replace identity fields when there is no scenario."""
    if scenario is not None:
        return controller_for(World.from_scenario(scenario, time.monotonic()), bind)
    values = dict(settings)
    if isinstance(values.get("version"), str):
        values["version"] = parse_version(values["version"])
    return Controller(bind, Identity(**values))
