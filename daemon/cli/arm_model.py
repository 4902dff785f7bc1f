"""What ``cellward check`` says of the arm's model: whose kinematics the daemon's own moves will go by."""

from collections.abc import Mapping
from typing import Any

from cell.calibrations import kinematics
from cell.errors import CellError
from cell.run_values import CONTROLLER, RunValues
from daemon.config import CellConfig
from daemon.predictions import ledger_rows
from daemon.tools import tools_of
from procedures.kinematics_in_use import in_words, misfits, other_arm, other_device, other_load

SWITCH = "[robot] use_kinematics"


def arm_in_use(config: CellConfig) -> dict[str, Any] | None:
    """``model`` as a run has it (None: jobs are refused), ``text`` and ``cautions``; None without an arm.

    What is accepted is read from the cell's ledger, which a running daemon may have open.
    """
    device = config.robot.roles().get("arm")
    if device is None:
        return None
    name, wanted = kinematics(device), config.robot.use_kinematics
    try:
        rows = ledger_rows(config)
    except CellError as exc:
        text = f"{SWITCH} is {str(wanted).lower()}; what is accepted is not known: {exc}"
        return {
            "model": None if wanted else dict(CONTROLLER),
            "text": text,
            "cautions": [text] if wanted else [],
        }
    committed = {row["name"]: row for row in rows if row["state"] == "committed"}
    found = committed.get(name)
    if found is None and wanted:
        return {"model": None, **_missing(name, rows)}
    model = {"name": name, "version": found["version"]} if found and wanted else dict(CONTROLLER)
    text = f"moves and poses go by {in_words(model)}"
    if found is not None and not wanted:
        text += f"; {name} version {found['version']} is accepted and not used, {SWITCH} = true would use it"
    made_with = {row["name"]: row["arm_model"] or dict(CONTROLLER) for row in committed.values()}
    versions = {row["name"]: row["version"] for row in committed.values()}
    values = RunValues(config.robot.robot_spec(), arm_model=model, made_with=made_with, versions=versions)
    cautions = list(misfits(values).values())
    if found is not None and wanted:
        cautions += _unfit(config, device, found["value"])
    return {"model": model, "text": text, "cautions": cautions}


def strangers(config: CellConfig, serials: Mapping[str, str]) -> list[str]:
    """Accepted kinematics that were measured with another arm than the one that says it has this serial.

    ``serials`` by device, as a probe found them; what nobody could tell says nothing.
    """
    try:
        rows = [row for row in ledger_rows(config) if row["state"] == "committed" and _device_of(row)]
    except CellError as exc:
        return [f"whose kinematics are accepted is not known: {exc}"]
    told = ((row, other_device(row["value"], "arm", serials.get(_device_of(row)))) for row in rows)
    return [f"{row['name']} version {row['version']}: {why}" for row, why in told if why]


def _device_of(row: Mapping[str, Any]) -> str:
    """The arm whose kinematics a row of the ledger has; no device's name for anything else."""
    kind, _, device = str(row["name"]).partition(".")
    return device if kind == "kinematics" else ""


def _missing(name: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    waiting = [row["id"] for row in rows if row["name"] == name and row["state"] == "proposed"]
    do = (
        f"'cellward accept {waiting[0]}' puts the one that waits into effect"
        if waiting
        else "run tracker-sampling"
    )
    text = f"{SWITCH} = true, and no version of {name} is accepted: jobs that use the arm are refused; {do}"
    return {"text": text, "cautions": [text]}


def _unfit(config: CellConfig, device: str, value: Mapping[str, Any]) -> list[str]:
    """Why the accepted version may not be this arm's, or not its load's, as far as the config tells."""
    serial = getattr(config.device[device], "expect_serial", None)
    why = (
        other_arm(value, config.robot.robot_spec()),
        other_device(value, "arm", serial),
        *_other_loads(config, value),
    )
    return [text for text in why if text]


def _other_loads(config: CellConfig, value: Mapping[str, Any]) -> list[str | None]:
    """Of each tool of the cell, for each may be on the flange; of a key that several share, once."""
    loads = {}
    for name, tool in tools_of(config).items():
        own = name in config.tool and config.tool[name].payload_kg is not None
        loads[f"[tool.{name}] payload_kg" if own else "[robot] payload_kg"] = tool.payload_kg
    return [other_load(value, load, key) for key, load in loads.items()]
