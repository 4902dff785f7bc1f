"""The arm: what a factory calibration leaves of its links, its gears, its weight, and how well it repeats."""

from typing import Any

import numpy as np

from cell.known_cell import KnownCell
from cell.poses import Array
from fakes.world.arm.kinematics import JOINTS, Chain, LinkDeltas, chain_of
from fakes.world.arm.truth import ArmTruth

# What a calibration leaves of the links, standard deviations. Its size is not published, so it is an
# assumption, the one of the scenario workshop, which gives the reasons for gears and sag as well.
LINK_M, LINK_RAD = 0.00006, 0.00009
GEAR_RAD, SAG_RAD = 0.00002, 0.0001
# Pose repeatability by ISO 9283 in the data sheets of the arms, m; it is 3.6 standard deviations of an axis.
REPEATABILITY_M = {
    "ur3e": 0.00003, "ur5e": 0.00003, "ur10e": 0.00005, "ur16e": 0.00005,
    "ur3": 0.0001, "ur5": 0.0001, "ur10": 0.0001, "ur20": 0.0001, "ur30": 0.0001,
}  # fmt: skip
OTHERS_M = 0.00005  # of an arm whose data sheet is not here
AXES = 3.6
# Of servoj; the scenario picking has the source of the one, fakes.world.arm.ripple that of the other.
SERVO = {"lag": "delay", "ripple_s": 0.00043}
# Measured on a UR5e: speeds of an idle joint up to 0.16 mrad/s, a force without contact of 2.3 N (median)
# that moved by 4.2 N within 8 s. The noise of the joints is an assumption.
REPORTED = {"q_noise_rad": 0.00001, "qd_noise_rad_s": 0.00005, "force_bias_n": 2.3, "force_walk_n": 2.0}
# How a pin in its holder leans about each axis, rad: ISO 2768-1, class m, allows 5.8 mrad over 50 to 120 mm,
# here taken for three standard deviations.
LEAN_RAD = 0.002
SERIAL = "99991100001"


def draw_arm(known: KnownCell, rng: np.random.Generator, late_s: float) -> dict[str, Any]:
    """``[world.arm]``, whose stamps are ``late_s`` late."""
    repeatability = REPEATABILITY_M.get(_model(known), OTHERS_M) / AXES
    sizes = {"delta_theta": LINK_RAD, "delta_d": LINK_M, "delta_a": LINK_M, "delta_alpha": LINK_RAD}
    return {
        **_named(known),
        "serial": SERIAL,
        "q_start": list(known.q_start),
        "repeatability_t_m": repeatability,
        "factory": _factory(known),
        "error": {name: (size * rng.standard_normal(JOINTS)).tolist() for name, size in sizes.items()},
        "joint_errors": {
            "gear_once_rad": GEAR_RAD,
            "gear_twice_rad": GEAR_RAD,
            "sag_rad": (SAG_RAD * rng.uniform(0.5, 1.5, 3)).tolist(),
        },
        "servo": SERVO,
        "reported": {**REPORTED, "stamp_late_s": late_s},
    }


def draw_tool(known: KnownCell, rng: np.random.Generator) -> dict[str, Any]:
    """``[world.tool]``: as configured, with a round pin at its end that leans, as thick as beams need it."""
    tool = {
        "name": known.tool["name"],
        "T_flange_tool": list(known.tool["T_flange_tool"]),
        "radius_m": known.tool["radius_m"],
        "payload_kg": known.payload_kg,
    }
    if known.beams is None:
        return tool
    radius = known.beams.pin_radius_m
    pin = {"from": [0.0, 0.0, -radius], "to": [0.0, 0.0, -0.06], "radius_m": radius}
    return {**tool, "shape": [pin], "lean_rad": (LEAN_RAD * rng.standard_normal(2)).tolist()}


def believed(known: KnownCell) -> Chain:
    """The arm as its controller has it."""
    truth = ArmTruth.model_validate(
        {**_named(known), "q_start": list(known.q_start), "factory": _factory(known)}
    )
    return chain_of(*truth.drawing(truth.factory.deltas()))


def tool_point(known: KnownCell, arm: Chain, q: Array) -> Array:
    """(3,) m in the base: the tool's point at joints ``q``."""
    point: Array = arm.forward(q).apply(np.array(known.tool["T_flange_tool"])[:3])
    return point


def _named(known: KnownCell) -> dict[str, Any]:
    model = _model(known)
    return {"model": model} if model else {"robot": dict(known.robot)}


def _model(known: KnownCell) -> str:
    """Of UR, or nothing for an arm of another maker."""
    return str(known.robot.get("model", "")) if "links" not in known.robot else ""


def _factory(known: KnownCell) -> dict[str, Any]:
    deltas = LinkDeltas()
    return {name: list(known.robot.get(name, value)) for name, value in vars(deltas).items()}
