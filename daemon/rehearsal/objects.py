"""The configured cell with devices that are objects of a twin, and a twin that suits it.

The twin is reached by its name alone: what ships with the daemon does not import it.
"""

import importlib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, cast

from cell.errors import CellError, error, present
from cell.known_cell import KnownCamera, KnownCell
from daemon.config import CellConfig
from daemon.config.drivers import DRIVERS
from daemon.config.findings import Findings
from daemon.config.load import check_config
from daemon.job_config import make_procedure
from daemon.predictions import setup_of
from daemon.rehearsal.sections import not_in_twin
from daemon.tools import ARGUMENT, CellTool, asked_tool
from procedures.documents import kind_named
from procedures.kind import load
from procedures.registry import JOBS
from procedures.rehearsal import HeldPoint, Rehearsal

TWIN = "fakes.likely"
# A rehearsal has no use for who may watch and trigger the daemon, and for how late a computer may be.
LEFT_OUT = ("modbus", "http", "mqtt", "can", "supervisor", "tool", "recipe")


class Twin(Protocol):
    """What the twin's module offers: a scenario for a known cell, the clock for it, and by role the drivers
    and, from the sections of the device and of the arm, what else theirs have."""

    CLOCK: str
    DRIVERS: Mapping[str, str]

    def likely_scenario(self, known: KnownCell, seed: int) -> str: ...
    def device_keys(self, role: str, section: Any, arm: Any) -> dict[str, Any]: ...


@dataclass(frozen=True)
class RehearsedCell:
    """The cell of objects that ``jobs`` run in, one after the other, each as its own of ``rehearsals`` has
    it; the last one is rehearsed. ``missing``: what sections of devices say and the twin does not have."""

    config: CellConfig
    jobs: tuple[str, ...]
    rehearsals: tuple[Rehearsal, ...]
    missing: tuple[str, ...] = ()


def rehearsed_cell(
    config: CellConfig, path: Path, job: str, seed: int, folder: Path, tool: str | None = None
) -> RehearsedCell:
    """A cell drawn by ``seed`` around the configuration ``path``, with its files in ``folder``.

    ``tool`` is on the flange, by its name; None: the one of a start that names none.

    ``CONFIG_INVALID`` says what the job or a twin of this cell lacks; others as of ``rehearsal_reference``.
    """
    on_flange = present(asked_tool(config, job, tool, needed=True), "tool")
    rehearsal = rehearsal_of(config, job, on_flange)
    before = [rehearsal_of(config, name, on_flange) for name in rehearsal.before]
    if rehearsal.held is not None:
        rehearsal = replace(rehearsal, camera=_with_place(rehearsal.held, before[0].camera))
    elif rehearsal.camera is None and before and (borrowed := before[0].camera) is not None:
        if borrowed.fixed:
            text = (
                f"{job} looks through the camera on the flange, and [job.{rehearsal.before[0]}] has setup = "
            )
            raise error("CONFIG_INVALID", text + '"eye-to-hand"')
        rehearsal = replace(rehearsal, camera=borrowed)
    if rehearsal.same_arm:
        if before[0].observed is None:
            text = f"{job} needs an observed arm that [job.{rehearsal.before[0]}] has sampled, and that has "
            raise error("CONFIG_INVALID", text + 'arm = "arm"')
        rehearsal = replace(rehearsal, tracker=before[0].tracker, observed=before[0].observed)
    twin = cast(Twin, importlib.import_module(TWIN))
    try:
        text = twin.likely_scenario(_known(config, rehearsal, on_flange), seed)
    except ValueError as exc:
        raise error("CONFIG_INVALID", f"{path}: no twin can be made for it: {exc}") from exc
    scenario = folder / "scenario.toml"
    scenario.write_text(text, "utf-8")
    jobs = (*rehearsal.before, job)
    raw = tomllib.loads(path.read_text("utf-8-sig"))
    roles = _roles_of(config, jobs)
    tables = _with_objects(config, raw, jobs, roles, on_flange, twin, folder)
    made = check_config(tables, Findings(f"the twin of {path}"), JOBS, DRIVERS, path)
    missing = tuple(not_in_twin(roles, config.device))
    return RehearsedCell(made, jobs, (*before, rehearsal), missing)


def rehearsal_reference(job: str) -> str:
    """``package.module:function`` that tells what ``job`` needs of a twin.

    ``UNKNOWN_JOB``; ``ARGUMENT_INVALID`` for a job that has no rehearsal.
    """
    if job in JOBS and (reference := kind_named(JOBS[job].kind).rehearsal):
        return reference
    known = ", ".join(name for name, j in JOBS.items() if kind_named(j.kind).rehearsal)
    if job in JOBS:
        raise error("ARGUMENT_INVALID", f"{job} cannot be rehearsed yet; these jobs can: {known}")
    raise error("UNKNOWN_JOB", f"there is no job '{job}'; these can be rehearsed: {known}")


def rehearsal_of(config: CellConfig, job: str, tool: CellTool | None = None) -> Rehearsal:
    """What ``job`` needs of a twin; ``CONFIG_INVALID`` when the configuration lacks it, and errors as of
    ``rehearsal_reference``."""
    reference = rehearsal_reference(job)
    try:
        procedure = make_procedure(JOBS[job], config, {})
        found: Rehearsal = load(reference)(setup_of(config, tool), procedure.config)
    except CellError as exc:
        raise error("CONFIG_INVALID", f"{job} cannot be rehearsed: {exc.detail}") from exc
    return found


def _with_place(held: HeldPoint, camera: KnownCamera | None) -> KnownCamera:
    """The ``camera`` of the job before, with one more place of its target."""
    if camera is None or camera.fixed or dict(camera.target) != dict(held.target):
        text = "the job before is with another target or a fixed camera, and a twin has one of each"
        raise error("CONFIG_INVALID", text)
    return replace(camera, looks=[*camera.looks, held.q])


def _known(config: CellConfig, rehearsal: Rehearsal, tool: CellTool) -> KnownCell:
    return KnownCell(
        robot=config.robot.robot_spec(),
        tool=tool.section(),
        payload_kg=tool.payload_kg,
        q_start=config.poses[rehearsal.look],
        camera=rehearsal.camera,
        beams=rehearsal.beams,
        tracker=rehearsal.tracker,
        belt=rehearsal.belt,
        gripper=rehearsal.gripper,
        rack=rehearsal.rack,
        observed=rehearsal.observed,
    )


def _roles_of(config: CellConfig, jobs: tuple[str, ...]) -> dict[str, str]:
    """The devices that ``jobs`` use, by role; a twin has an arm, whether a job moves it or not."""
    used = {"arm"} | {role for name in jobs for role in make_procedure(JOBS[name], config, {}).uses()}
    return {role: name for role, name in config.robot.roles().items() if role in used}


def _with_objects(
    config: CellConfig,
    raw: Mapping[str, Any],
    jobs: tuple[str, ...],
    roles: Mapping[str, str],
    tool: CellTool,
    twin: Twin,
    folder: Path,
) -> dict[str, Any]:
    """The tables of ``raw`` with the devices of ``roles`` as objects, and without all others."""
    devices = {
        name: {
            "driver": twin.DRIVERS[role],
            "scenario": str(folder / "scenario.toml"),
            **twin.device_keys(role, config.device[name], config.device[roles["arm"]]),
        }
        for role, name in roles.items()
    }
    unused = set(config.robot.roles()) - set(roles)
    if "observed_arm" not in roles:
        unused.add("observed_model")
    # The twin's arm was never calibrated, so its moves go by its controller's model.
    kept_keys = {k: v for k, v in raw["robot"].items() if k not in unused}
    robot = {**kept_keys, "use_kinematics": False, **roles, "tool": tool.section(), **tool.load()}
    kept = {k: v for k, v in raw.items() if k not in LEFT_OUT}
    return {
        **kept,
        "cell": {
            "name": config.cell.name,
            "twin": True,
            "clock": twin.CLOCK,
            "state_dir": str(folder / "state"),
            "control_socket": str(folder / "control.sock"),
        },
        "robot": robot,
        "device": devices,
        "job": {name: _section(raw, name, name != jobs[-1]) for name in raw.get("job", {}) if name in jobs},
    }


def _section(raw: Mapping[str, Any], name: str, accepted: bool) -> dict[str, Any]:
    """``[job.NAME]``; the result of an ``accepted`` one is what the next job stands on."""
    section = {key: value for key, value in raw["job"][name].items() if key != ARGUMENT}
    if accepted:
        section["accept"] = {**section.get("accept", {}), "auto": True}
    return section
