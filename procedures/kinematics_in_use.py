"""Which model of the arm a run works with, whether it is this arm's, and what was calibrated with another.

``values.arm_model`` is ``{"name": "controller"}``, or ``{"name": "kinematics.<device>", "version": n}``.
The calibrated ROBOT itself is in ``values.kinematics["arm"]``, where only versions in effect get: a result
that is merely proposed is never used.
"""

from collections.abc import Mapping
from typing import Any, TypeVar

from cell.calibrations import kinematics, on_flange, rests_on_kinematics
from cell.errors import error, present
from cell.formats.result import Envelope, ModelInUse, Warning_
from cell.run_values import CONTROLLER, RunValues

R = TypeVar("R", bound=Envelope)
SAME_LOAD_KG = 1e-3  # an arm bends under its load: a calibration holds for the one it was made with
LOAD_OF_A_RUN = "payload_kg with this tool"  # in the configuration of the tool, else of the arm
DIFFER, LOAD = "kinematics.differ", "kinematics.payload"  # codes of warnings in results


def choose_model(values: RunValues, device: str | None, serial: str | None) -> dict[str, Any]:
    """The model for a run of ``values`` with the arm ``device`` and its ``serial`` (None: not known).

    The controller's unless ``values.use_kinematics``; then the calibrated one in effect.
    ``KINEMATICS_MISSING`` when there is none, ``KINEMATICS_OTHER_ARM`` when it is of another arm.
    """
    if not values.use_kinematics:
        return dict(CONTROLLER)
    found: Mapping[str, Any] | None = values.kinematics.get("arm")
    if found is None or device is None:
        raise error("KINEMATICS_MISSING", "nothing was accepted yet" if device else "[robot] names no arm")
    if why := other_arm(found, values.robot) or other_device(found, "arm", serial):
        raise error("KINEMATICS_OTHER_ARM", why)
    name = kinematics(device)
    return {"name": name, "version": values.versions[name]}


def in_use(values: RunValues) -> Mapping[str, Any] | None:
    """The calibrated ROBOT that the run works with; None where it believes the controller."""
    if values.arm_model == CONTROLLER:
        return None
    robot: Mapping[str, Any] = _measured(values)["robot"]
    return robot


def _measured(values: RunValues) -> Mapping[str, Any]:
    return present(values.kinematics["arm"], "kinematics for a run that goes by them")


def in_words(model: Mapping[str, Any]) -> str:
    """A model as a person reads it."""
    if model["name"] == CONTROLLER["name"]:
        return "the controller's own kinematics"
    return f"{model['name']} version {model.get('version')}"


# -- whose kinematics they are


def other_arm(found: Mapping[str, Any], robot: Mapping[str, Any]) -> str | None:
    """Why the kinematics ``found`` are of another arm than ``robot``, the model of the controller."""
    believed = found.get("controller")
    if believed is None or not _differ(believed, robot):
        return None
    return (
        "the kinematics in effect are of another arm: its model or factory calibration is not that of "
        "this arm's controller"
    )


def other_device(found: Mapping[str, Any], role: str, serial: str | None) -> str | None:
    """Why they were measured with another device of this ``role``; an unknown ``serial`` says nothing."""
    then = (found.get("serials") or {}).get(role)
    if not then or not serial or then == serial:
        return None
    return f"the kinematics in effect were measured with {role} {then}, and this is {role} {serial}"


def other_load(found: Mapping[str, Any], payload_kg: float, key: str) -> str | None:
    """Why they hold for another load than the arm has now, by the ``key`` of its configuration; None when
    they do not say or it is the same."""
    load = found.get("payload_kg")
    if load is None or abs(load - payload_kg) <= SAME_LOAD_KG:
        return None
    return f"the kinematics in effect were measured with {load:g} kg, {key} is {payload_kg:g} kg"


def _differ(a: Mapping[str, Any], b: Mapping[str, Any]) -> bool:
    """Whether two ROBOTs are not one arm, whatever is on its flange and however well it is believed.

    A controller may have kept its calibration to itself once; it counts where both have it.
    """
    keys = (set(a) | set(b)) - {"tool", "prior"}
    if not ("calibration" in a and "calibration" in b):
        keys.discard("calibration")
    return any(a.get(key) != b.get(key) for key in keys)


# -- what was calibrated with it


def made_otherwise(values: RunValues, name: str) -> str | None:
    """Why the version of ``name`` in effect does not fit the model in use; None when it does.

    A configured value comes from a drawing and fits every model.
    """
    made = values.made_with.get(name)
    now = values.arm_model
    if made is None or made == now:
        return None
    return (
        f"{name} version {values.versions[name]} was made with {in_words(made)}, and this run works with "
        f"{in_words(now)}"
    )


def require_same_model(values: RunValues, name: str) -> None:
    """``KINEMATICS_DIFFER`` for a value that brings measurements into the base, made with another model."""
    if why := made_otherwise(values, name):
        raise error("KINEMATICS_DIFFER", why)


def misfits(values: RunValues) -> dict[str, str]:
    """By ledger name, why what is in effect does not fit the model in use."""
    names = filter(rests_on_kinematics, values.made_with)
    return {name: why for name in names if (why := made_otherwise(values, name))}


def with_model(result: R, values: RunValues, renewed: set[str]) -> R:
    """A result that names the model it was made with, and warns of what fits it less than well.

    Those are values on the flange from another model, but for the ``renewed`` ones, and another load. The
    verdict is the job's own: it stays.
    """
    found = [
        (DIFFER, text) for name, text in misfits(values).items() if on_flange(name) and name not in renewed
    ]
    if in_use(values) is not None:
        load = other_load(_measured(values), values.payload_kg, LOAD_OF_A_RUN)
        found += [(LOAD, load)] if load else []
    new = [warning for warning in Warning_.each(found) if warning not in result.warnings]
    named = result.with_inputs(arm_model=ModelInUse.model_validate(dict(values.arm_model)))
    return named.changed(warnings=[*result.warnings, *new])
