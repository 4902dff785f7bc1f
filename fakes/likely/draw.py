"""The whole scenario: the arm, and whatever parts are known."""

from math import sqrt
from typing import Any

import numpy as np

from cell.known_cell import KnownCell, KnownDelay
from cell.usual_delays import ARM_LATE_S
from fakes.likely.arm import believed, draw_arm, draw_tool
from fakes.likely.beams import FILTER_S, SCAN_S, draw_beams
from fakes.likely.belt import draw_belt, draw_gripper
from fakes.likely.camera import draw_camera
from fakes.likely.observed import draw_observed
from fakes.likely.rack import draw_rack
from fakes.likely.tracker import draw_tracker
from fakes.world.arm.truth import ArmTruth
from fakes.world.scenario import SCHEMA, Scenario
from fakes.world.toml_text import to_toml

CLOCK = "fakes.object:VirtualClock"
LATEST_S = 0.2  # by which the stamps of a twin's camera or encoder may be late or early
_SIGMAS = 5.0  # that no draw is beyond
_HALF95 = 1.96  # standard deviations
_ARM_LATE, _CAMERA_LATE, _ENCODER_LATE, _TOOL = 0xA5, 0xA6, 0xA7, 0xA8  # beside the seed


def likely_scenario(known: KnownCell, seed: int) -> str:
    """TOML text of a scenario; the same ``seed`` draws the same cell.

    ``CONFIG_INVALID`` when what is known does not make a cell; ``ValueError`` when a beam or a board has no
    room where the configuration wants it, or when a measured delay is more than a twin's stamps can be late.
    """
    # One generator a part: what one part draws changes nothing of the others.
    rngs = dict(
        zip(("arm", *known.parts), np.random.default_rng(seed).spawn(1 + len(known.parts)), strict=True)
    )
    arm = believed(known)
    # What was measured of the others is against the arm, which is late itself.
    arm_late_s = float(np.random.default_rng([seed, _ARM_LATE]).uniform(*ARM_LATE_S))
    world: dict[str, Any] = {
        "seed": seed,
        "arm": draw_arm(known, rngs["arm"], arm_late_s),
        "tool": draw_tool(known, np.random.default_rng([seed, _TOOL])),
    }
    if known.camera is not None:
        world |= draw_camera(known.camera, arm, rngs["camera"])
        if (delay := known.camera.pictures.delay) is not None:
            world["camera"]["stamp_late_s"] = arm_late_s + _measured(delay, seed, _CAMERA_LATE)
    if known.beams is not None:
        world |= draw_beams(known, arm, rngs["beams"])
    if known.tracker is not None:
        world |= draw_tracker(known.tracker, rngs["tracker"])
    if known.belt is not None:
        world |= draw_belt(known.belt, rngs["belt"])
        if (delay := known.belt.delay) is not None:
            # What was measured is the delay on average, and counts are later by half of their jitter.
            camera = known.camera.pictures.delay if known.camera is not None else None
            late_s = arm_late_s + _measured(delay, seed, _ENCODER_LATE, camera)
            world["belt"]["late_s"] = late_s - 0.5 * world["belt"]["jitter_s"]
    if known.gripper is not None:
        world["gripper"] = draw_gripper(known.gripper, rngs["gripper"])
        if known.gripper.place_clear is not None:
            late = {"filter_s": FILTER_S, "scan_s": SCAN_S}
            world["place"] = {"input": known.gripper.place_clear, **late}
    if known.rack is not None:
        world["rack"] = draw_rack(known.rack, ArmTruth.model_validate(world["arm"]), seed, rngs["rack"])
    if known.observed is not None:
        world["observed"] = draw_observed(known.observed, rngs["observed"])
    text = to_toml({"schema": SCHEMA, "world": world})
    Scenario.parse(text, "the likely cell")
    return text


def _measured(delay: KnownDelay, seed: int, of: int, camera: KnownDelay | None = None) -> float:
    """s: a delay about the measured one, which is against the arm's stamps.

    ``camera``: that of the camera by which an encoder was measured. While its version is in effect, what is
    open of it is open of the encoder alike, and the encoder has its own part beside that.
    """
    if abs(delay.late_s) + _SIGMAS * delay.sigma_s + ARM_LATE_S[1] > LATEST_S:
        late_ms, half_ms = 1e3 * delay.late_s, 1e3 * _HALF95 * delay.sigma_s
        raise ValueError(
            f"{delay.name} in effect is {late_ms:.1f} +- {half_ms:.1f} ms (95 %), and stamps of a twin are "
            f"late by {1e3 * LATEST_S:g} ms at most, by which the arm is late included: look for what "
            "makes that device so late and measure it anew, or take the version back "
            f"('cellward rollback {delay.name}') to rehearse with a usual delay"
        )
    shared_s, own_s = 0.0, delay.sigma_s
    if camera is not None and delay.camera_sigma_s:
        shared_s = camera.sigma_s * _drawn(seed, _CAMERA_LATE)
        own_s = sqrt(max(delay.sigma_s**2 - camera.sigma_s**2, 0.0))
    return delay.late_s + shared_s + own_s * _drawn(seed, of)


def _drawn(seed: int, of: int) -> float:
    """Of a normal distribution, in standard deviations."""
    return float(np.random.default_rng([seed, of]).standard_normal())
