"""How well arm, lens and target are known: as the data state it, else a default; each with its source."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from calibration.adjustment.arm_terms import ArmPrior, arm_prior
from calibration.adjustment.lens_terms import LensPrior, TargetPrior, lens_prior, target_prior
from cell.formats.robot import Robot

# Of intrinsics that were found from the same images: those images are in the adjustment, so nothing else is.
_FROM_IMAGES = LensPrior(focal=0.05, aspect=0.01, centre_px=50.0, radial=0.2, tangential=0.01)

NO_ARM = "arm.accuracy"


@dataclass(frozen=True)
class KnownParts:
    """The priors of an adjustment, and by part where each comes from."""

    arm: ArmPrior
    lens: LensPrior
    target: TargetPrior
    sources: Mapping[str, str]


def known_parts(
    target: Mapping[str, Any],
    camera_sigma: Mapping[str, Any] | None,
    robot: Robot | None,
    from_images: bool = False,
) -> KnownParts:
    """``target`` as in a data set, ``camera_sigma`` its ``camera.sigma``; ``from_images``: the camera was
    estimated from the images that are solved."""
    arm, arm_source = _arm(robot)
    lens, lens_source = (_FROM_IMAGES, "found from the images") if from_images else known_lens(camera_sigma)
    board, board_source = _target(target)
    sources = {"lens": lens_source, "target": board_source}
    return KnownParts(arm, lens, board, ({"arm": arm_source} if robot is not None else {}) | sources)


def _arm(robot: Robot | None) -> tuple[ArmPrior, str]:
    """How good an arm is differs by a factor of ten, so the data have a say in the scale of its prior."""
    given = None if robot is None else robot.prior
    prior, source = arm_prior(given), "default" if given is None else "robot.prior"
    return prior, f"{source}, its scale by the data ({_arm_text(prior)})"


def _arm_text(prior: ArmPrior) -> str:
    return (
        f"lengths {1e3 * prior.length:g} mm, angles {1e3 * prior.angle:g} mrad, "
        f"gears {1e6 * prior.gear:g} urad, sag {1e6 * prior.sag:g} urad"
    )


def shared_source(t: float, r: float) -> str:
    """What is known of an arm whose joints are not given: one axis of its flange is off by m and rad."""
    assumed = f"assumed of the arm before the data: {_sizes(t, r)} an axis of the flange"
    return f"errors that neighbouring poses share ({assumed}), their scale by the data"


def without_joints(why: str, t: float, r: float) -> tuple[str, str]:
    """The warning that there are no joints, ``why``, and how large the errors are that were found: m, rad."""
    return NO_ARM, (
        f"{why}: errors of the flange that neighbouring poses share ({_sizes(t, r)} an axis by the data) are "
        "in the uncertainty as far as these poses show them; robot and q of every observation tell the "
        "arm's geometry"
    )


def _sizes(t: float, r: float) -> str:
    return f"{1e3 * t:.2g} mm, {1e3 * r:.2g} mrad"


def known_lens(sigma: Mapping[str, Any] | None) -> tuple[LensPrior, str]:
    """The prior of a camera with ``camera.sigma``, and where it comes from."""
    prior = lens_prior(sigma)
    told = {"f": f"focal length {100 * prior.focal:g} %", "c_px": f"principal point {prior.centre_px:g} px"}
    default = "a camera that its maker has calibrated"
    return prior, _source("camera.sigma.", "camera.sigma", told, sigma or {}, default)


def _target(target: Mapping[str, Any]) -> tuple[TargetPrior, str]:
    prior = target_prior(target)
    told = {
        "scale_sigma": f"printed size {100 * prior.scale:g} %",
        "flatness_m": f"flat to {1e3 * prior.bow:g} mm",
    }
    both = "target.scale_sigma and target.flatness_m"
    return prior, _source("target.", both, told, target, "one sheet from an office printer")


def _source(one: str, both: str, told: Mapping[str, str], given: Mapping[str, Any], default: str) -> str:
    """Where a prior of two keys comes from, with their values as ``told``: both stated, one, or neither."""
    stated = [key for key in told if given.get(key) is not None]
    if not stated:
        return f"default: {default} ({', '.join(told.values())})"
    usual = [value for key, value in told.items() if key not in stated]
    if usual:
        return f"{one}{stated[0]} ({told[stated[0]]}); default: {', '.join(usual)}"
    return f"{both} ({', '.join(told.values())})"
