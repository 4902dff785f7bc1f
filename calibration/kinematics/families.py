"""From a ROBOT to an arm whose parameters can be adjusted, and from adjusted parameters back to a ROBOT."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibration.kinematics.chain import SerialChain
from calibration.kinematics.hayati import with_near_frames
from calibration.kinematics.joint_errors import JointErrors
from calibration.kinematics.palletizer import palletizer
from calibration.kinematics.parametric import Kind, ParametricArm
from calibration.kinematics.ur_models import ALPHA, UR_MODELS
from cell.errors import error
from cell.formats.robot import (
    JointError,
    NamedRobot,
    PalletizerRobot,
    Prior,
    Robot,
    Serial6Robot,
    SerialRobot,
)
from cell.poses import Array

NEAR_PARALLEL = 0.0175  # rad; closer axes need Hayati's form
_PARALLEL_LINKS = (1, 2)  # shoulder, elbow and wrist 1 of a UR arm


@dataclass(frozen=True, eq=False)
class ArmSpec:
    """A ROBOT as mathematics. ``tools`` are the given places (3,) of the targets on the last frame, m."""

    robot: Robot
    arm: ParametricArm
    tools: dict[str, Array]
    prior: Prior

    @property
    def tool_in_parameters(self) -> str | None:
        """The target whose place belongs to the arm's own parameters (tx, ty, tz)."""
        return "smr1" if isinstance(self.robot, PalletizerRobot) else None


def arm_spec(robot: Robot, where: str = "robot") -> ArmSpec:
    """The arm of a ROBOT; ``DATA_INVALID`` for a model that is not known."""
    tools = {name: np.array(place, dtype=float) for name, place in robot.tool.items()}
    prior = robot.prior or Prior()
    if isinstance(robot, PalletizerRobot):
        arm = _with_known_errors(palletizer(robot.parameters), robot.joint_errors)
        tools["smr1"] = np.array([robot.parameters.tx, robot.parameters.ty, robot.parameters.tz])
    elif isinstance(robot, SerialRobot):
        arm = _with_known_errors(_serial(robot), robot.joint_errors)
    elif isinstance(robot, Serial6Robot):
        arm = _serial6(robot)
    else:
        arm = _named(robot, where)
    return ArmSpec(robot, arm, tools, prior)


def _with_known_errors(arm: ParametricArm, errors: list[JointError]) -> ParametricArm:
    """``arm`` whose joints turn further than they read, as its ROBOT says."""
    if not errors:
        return arm
    known = JointErrors(
        tuple(e.name for e in errors),
        np.array([e.joint - 1 for e in errors], dtype=np.int64),
        np.array([e.of for e in errors]),
        np.array([e.sin for e in errors]),
        np.array([e.cos for e in errors]),
    )
    return replace(arm, base=replace(arm.base, errors=known))


def errors_document(chain: SerialChain) -> list[dict[str, Any]]:
    """``joint_errors`` of a ROBOT."""
    errors = chain.errors
    if errors is None:
        return []
    return [
        {
            "name": name,
            "joint": int(errors.joint[k]) + 1,
            "of": errors.of[k].tolist(),
            "sin": float(errors.sin[k]),
            "cos": float(errors.cos[k]),
        }
        for k, name in enumerate(errors.names)
    ]


def chain_parameters(
    chain: SerialChain, betas: list[int], ratios: list[tuple[int, int]], family: str
) -> ParametricArm:
    """One parameter for each number of a chain, with ``beta`` and coupling entries where asked for."""
    m = len(chain.theta)
    quantities: tuple[tuple[str, Kind], ...] = (
        ("theta", "angle"),
        ("d", "length"),
        ("a", "length"),
        ("alpha", "angle"),
    )
    names = [f"{quantity}{i + 1}" for quantity, _ in quantities for i in range(m)]
    names += [f"beta{i + 1}" for i in betas] + [f"k{i + 1}.{j + 1}" for i, j in ratios]
    kinds: list[Kind] = [kind for _, kind in quantities for _ in range(m)]
    kinds += ["angle" for _ in betas]
    kinds += ["ratio" for _ in ratios]
    nominal = np.concatenate(
        [chain.theta, chain.d, chain.a, chain.alpha, chain.beta[betas], [chain.coupling[r] for r in ratios]]
    )
    return ParametricArm(
        family=family,
        names=tuple(names),
        kinds=tuple(kinds),
        nominal=nominal,
        base=chain,
        betas=np.array(betas, dtype=np.int64),
        ratios=np.array(ratios, dtype=np.int64).reshape(-1, 2),
    )


def optional_numbers(arm: ParametricArm) -> tuple[list[int], list[tuple[int, int]]]:
    """What an arm may have but its parameters leave fixed: links whose next axis is near parallel and that
    lack a ``beta``, and entries of the coupling. Only chains of one parameter per number have any."""
    chain = arm.base
    if arm.mix is not None:
        return [], []
    m = len(chain.theta)
    angle = np.arccos(np.clip(np.cos(chain.alpha) * np.cos(chain.beta), -1.0, 1.0))
    straight = (angle < NEAR_PARALLEL) | (np.pi - angle < NEAR_PARALLEL)
    turns = np.any(chain.coupling, axis=1) & ~chain.sliding
    betas = [i for i in range(m - 1) if straight[i] and turns[i] and turns[i + 1] and i not in arm.betas]
    own = {(int(i), int(j)) for i, j in arm.ratios}
    moving = np.any(chain.coupling, axis=1)
    plain = np.array_equal(chain.coupling[moving], np.eye(int(moving.sum())))
    ratios = [] if plain else [(int(i), int(j)) for i, j in np.argwhere(chain.coupling)]
    return betas, [r for r in ratios if r not in own]


def with_optional(arm: ParametricArm, betas: list[int], ratios: list[tuple[int, int]]) -> ParametricArm:
    """``arm`` with more parameters, of :func:`optional_numbers`."""
    return chain_parameters(
        arm.base,
        sorted([*map(int, arm.betas), *betas]),
        sorted([*((int(i), int(j)) for i, j in arm.ratios), *ratios]),
        arm.family,
    )


def robot_document(
    spec: ArmSpec, arm: ParametricArm, values: Array, tools: dict[str, Array]
) -> dict[str, Any]:
    """The ROBOT with parameters ``values`` (p,) of ``arm``: what ``--robot`` reads, in full precision."""
    document: dict[str, Any]
    if isinstance(spec.robot, PalletizerRobot):
        own = zip(arm.names[: arm.geometric], values[: arm.geometric], strict=True)
        parameters = {name: float(v) for name, v in own}
        place = tools.get("smr1", spec.tools["smr1"])
        parameters |= {f"t{axis}": float(v) for axis, v in zip("xyz", place, strict=True)}
        document = {"family": "palletizer4", "parameters": parameters}
        tools = {name: place for name, place in tools.items() if name != "smr1"}
    else:
        document = {"family": "serial", **chain_document(arm.chain(values), {int(i) for i in arm.betas})}
    if errors := errors_document(arm.chain(values)):
        document["joint_errors"] = errors
    if tools:
        document["tool"] = {name: [float(v) for v in place] for name, place in tools.items()}
    return document


def chain_document(chain: SerialChain, betas: set[int]) -> dict[str, Any]:
    """``links`` and ``coupling`` of a ROBOT."""
    links = []
    for i in range(len(chain.theta)):
        link: dict[str, Any] = {key: float(getattr(chain, key)[i]) for key in ("theta", "d", "a", "alpha")}
        if i in betas or chain.beta[i] != 0.0:
            link["beta"] = float(chain.beta[i])
        moves = bool(np.any(chain.coupling[i]))
        link["joint"] = "fixed" if not moves else "prismatic" if chain.sliding[i] else "revolute"
        links.append(link)
    document: dict[str, Any] = {"links": links}
    moving = chain.coupling[np.any(chain.coupling, axis=1)]
    if not np.array_equal(moving, np.eye(len(moving))):
        document["coupling"] = moving.tolist()
    return document


def _named(robot: NamedRobot, where: str) -> ParametricArm:
    if robot.model not in UR_MODELS:
        raise error(
            "DATA_INVALID",
            f"{where}.model {robot.model!r} is not supported; supported are {', '.join(UR_MODELS)}",
        )
    model = UR_MODELS[robot.model]
    chain = ur_chain(robot.model)
    if robot.calibration is not None:
        given = robot.calibration.model_dump()
        added = {key: np.array(given[f"delta_{key}"] or np.zeros(6)) for key in ("theta", "d", "a", "alpha")}
        chain = replace(chain, **{key: getattr(chain, key) + row for key, row in added.items()})
        chain = with_near_frames(chain, _PARALLEL_LINKS, [float(model.d[i]) for i in _PARALLEL_LINKS])
    return chain_parameters(chain, list(_PARALLEL_LINKS), [], "ur")


def ur_chain(name: str) -> SerialChain:
    """The published arm of Universal Robots."""
    model, none = UR_MODELS[name], np.zeros(6)
    return SerialChain(none, model.d, model.a, ALPHA.copy())


def _serial(robot: SerialRobot) -> ParametricArm:
    links = robot.links
    moving = [i for i, link in enumerate(links) if link.joint != "fixed"]
    given = np.eye(len(moving)) if robot.coupling is None else np.array(robot.coupling, dtype=float)
    coupling = given
    if len(given) != len(links):
        coupling = np.zeros((len(links), given.shape[1]))
        coupling[moving] = given
    theta, d, a, alpha = (
        np.array([getattr(link, key) for link in links]) for key in ("theta", "d", "a", "alpha")
    )
    chain = SerialChain(
        theta=theta,
        d=d,
        a=a,
        alpha=alpha,
        beta=np.array([link.beta or 0.0 for link in links]),
        sliding=np.array([link.joint == "prismatic" for link in links]),
        coupling=coupling,
    )
    betas = [i for i, link in enumerate(links) if link.beta is not None]
    stated = robot.prior is not None and robot.prior.ratio is not None and robot.coupling is not None
    ratios = [(int(i), int(j)) for i, j in np.argwhere(coupling)] if stated else []
    return chain_parameters(chain, betas, ratios, "serial")


def _serial6(robot: Serial6Robot) -> ParametricArm:
    theta, d, a, alpha = (
        np.array([getattr(link, key) for link in robot.links]) for key in ("theta", "d", "a", "alpha")
    )
    chain = SerialChain(theta, d, a, alpha)
    straight = [i for i in range(5) if abs(np.sin(alpha[i])) < NEAR_PARALLEL]
    return chain_parameters(chain, straight, [], "serial6")
