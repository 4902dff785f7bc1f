"""What is exported: a committed version from the ledger, or the answer of a result file."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from calibration.kinematics.ur_models import UR_MODELS
from calibration.lengths import length95
from cell.errors import error
from cell.formats.reading import read_json
from cell.formats.result import Envelope, Result
from cell.store.runs import altered_in
from daemon.cli.options import CellPaths
from procedures.documents import read_result
from procedures.kind import KINDS, load
from procedures.kinematics_in_use import other_arm, other_device
from procedures.report.numbers import covariance, dig, number

POSE, KINEMATICS, VALUE = "pose", "kinematics", "value"


@dataclass(frozen=True)
class Exported:
    """One calibration with what a reader has to know of it. ``value`` is a pose6, or as the ledger has it.

    ``uncertainty`` has SI numbers by name and ``told`` the same in words. ``model`` is the arm's type where
    one is known, ``payload_kg`` the load that it was measured with. ``tool`` is what ``T_flange_tool`` is of.
    """

    name: str
    value: Any
    version: int | None
    date: str
    source: str
    uncertainty: dict[str, Any]
    told: str
    warnings: list[str] = field(default_factory=list)
    model: str | None = None
    payload_kg: float | None = None

    @property
    def kind(self) -> str:
        """How it can be written: a pose, an arm's kinematics, or just a value."""
        if self.name.split(".")[0] == "kinematics":
            return KINEMATICS
        return POSE if self.frames is not None else VALUE

    @property
    def frames(self) -> tuple[str, str] | None:
        """Parent and child of ``T_parent_child``; None for anything else."""
        parts = self.name.split(".")[0].split("_")
        is_pose = (
            len(parts) == 3 and parts[0] == "T" and isinstance(self.value, list) and len(self.value) == 6
        )
        return (parts[1], parts[2]) if is_pose else None

    @property
    def direction(self) -> str:
        """In words: what maps to what."""
        if self.kind == KINEMATICS:
            return "flange in base, from the joints"
        return "" if self.frames is None else f"{self.frames[1]} in {self.frames[0]}"

    @property
    def ur_model(self) -> str | None:
        """The type of a UR arm; None for an arm of another maker."""
        model = self.robot.get("model") or self.model
        return str(model) if model in UR_MODELS else None

    @property
    def robot(self) -> dict[str, Any]:
        """The ROBOT of a ``kinematics`` value."""
        found = self.value.get("robot", self.value) if isinstance(self.value, Mapping) else None
        if not isinstance(found, Mapping):
            raise error("DATA_INVALID", f"{self.name} holds no ROBOT; measure again with tracker-sampling")
        return dict(found)


def from_file(path: Path) -> Exported:
    """The answer of a ``cellward.result/1`` file or run folder; one that failed is refused."""
    file = path / "result.json" if path.is_dir() else path
    if path.is_dir() and altered_in(path):
        raise error(
            "DATA_INVALID", f"{file} was altered after the end of its run, so it is not what the job found"
        )
    result = read_json(file)
    if result.get("schema") != "cellward.result/1":
        raise error("DATA_INVALID", f"{file} is no result (cellward.result/1); give one, or a ledger name")
    found = read_result(result, str(file))
    if isinstance(found, Result) or found.verdict == "fail":
        why = next(iter(found.reasons or ["its verdict is fail"]))
        raise error("DATA_INVALID", f"{file} holds nothing to use: {why}")
    exported = found.exported()
    if exported is None:
        raise error(
            "DATA_INVALID",
            f"{file} is a result of kind '{found.kind}' without a calibration to export; a job's result of "
            f"{', '.join(_exporting())} has one",
        )
    name, value = exported
    changed = datetime.fromtimestamp(file.stat().st_mtime, UTC)
    return _of(name, value, result, None, changed, f"result file {file.name}")


def _exporting() -> list[str]:
    """The kinds whose results hold a calibration."""
    models = {kind.name: load(kind.result) for kind in KINDS.values()}
    return [name for name, model in models.items() if model.exported is not Envelope.exported]


def from_ledger(name: str, paths: CellPaths) -> Exported:
    """The version of ``name`` in effect. ``NOT_FOUND`` when none is committed, ``RESULT_CONFLICT`` when the
    configured value was edited since, ``KINEMATICS_OTHER_ARM`` when it is not of the arm that the config
    names."""
    from daemon.config import load_config
    from daemon.values import tell_configured

    if not paths.ledger.exists():
        raise error("NOT_FOUND", f"{name}: nothing is committed in this cell yet; {paths.ledger} is missing")
    from cell.store.ledger import Ledger
    from cell.store.summary import whole_result

    ledger = Ledger(paths.ledger, read_only=True)
    try:
        config = load_config(paths.config)
        tell_configured(config, ledger)
        found = ledger.in_effect(name)
        rows = ledger.results()
    finally:
        ledger.close()
    if found is None:
        raise error("NOT_FOUND", _not_committed(name, rows))
    if found["edited"]:
        raise error(
            "RESULT_CONFLICT",
            f"the configured value of {name} was edited since version {found['version']} replaced it",
        )
    _require_own_arm(name, found["value"], config)
    decided = datetime.fromtimestamp(found["decided"] or found["proposed"], UTC)
    source = f"result {found['id']} of run {found['run_id']}, accepted by {found['who']}"
    result = whole_result(found, paths.runs) or found["result"]
    if not result:
        source += (
            f"; the folder of run {found['run_id']} is gone, so its uncertainty and warnings are unknown"
        )
    return _of(name, found["value"], result or {}, found["version"], decided, source)


def _require_own_arm(name: str, value: Any, config: Any) -> None:
    """Kinematics written for another program no longer tell whose they are: the arm in the cell's config is
    meant, by its serial number and, where it is moved, by its model and factory calibration."""
    kind, _, device = name.partition(".")
    if kind != "kinematics" or not isinstance(value, Mapping) or device not in config.device:
        return
    why = other_device(value, "arm", getattr(config.device[device], "expect_serial", None))
    if why is None and config.robot.roles().get("arm") == device:
        why = other_arm(value, config.robot.robot_spec())
    if why is not None:
        raise error("KINEMATICS_OTHER_ARM", f"{name}: {why}")


def _not_committed(name: str, rows: list[dict[str, Any]]) -> str:
    waiting = [r["id"] for r in rows if r["name"] == name and r["state"] in ("proposed", "accepted")]
    if waiting:
        return f"{name} has no committed version; 'cellward accept {waiting[0]}' commits the one that waits"
    there = sorted({r["name"] for r in rows if r["state"] == "committed"})
    return f"{name} has no committed version; there is {', '.join(there) or 'none of any name'}"


def _of(
    name: str, value: Any, result: Mapping[str, Any], version: int | None, date: datetime, source: str
) -> Exported:
    uncertainty, told = uncertainty_of(name, result)
    warnings = [str(w.get("text")) for w in result.get("warnings") or [] if isinstance(w, Mapping)]
    stamp = date.isoformat(timespec="seconds").replace("+00:00", "Z")
    model = dig(result, "inputs", "robot", "model")
    load = number(dig(result, "result", "payload_kg")) if name.split(".")[0] == "kinematics" else None
    return Exported(name, value, version, stamp, source, uncertainty, told, warnings, model, load)


def uncertainty_of(name: str, result: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """Numbers (m, rad) and words of what the result document says of its own uncertainty."""
    if name.split(".")[0] == "kinematics":
        return _of_arm(result)
    cov = covariance(dig(result, "result", "cov")) if result.get("kind") == "hand-eye" else None
    t = number(dig(result, "uncertainty", "U_point_m"))
    r = number(dig(result, "uncertainty", "U_tilt_rad"))
    found: dict[str, Any] = {}
    if cov is not None:
        t, r = length95(cov[:3, :3]), length95(cov[3:, 3:])
        sigma = np.sqrt(np.maximum(np.diag(cov), 0.0))
        found = {"sigma_m": sigma[:3].tolist(), "sigma_rad": sigma[3:].tolist()}
    if t is None:
        return {}, "the result states no uncertainty"
    told = f"95 % of errors below {1e3 * t:.4f} mm"
    found["error_95_m"] = t
    if r is not None:
        found["error_95_rad"] = r
        told += f" and {np.degrees(r):.4f} deg"
    return found, told


def _of_arm(result: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    predicted = number(dig(result, "uncertainty", "predicted_95", "workspace", "max"))
    aside = number(
        dig(result, "result", "absolute_accuracy", "after")
    )  # a job's; a solved file has folds alone
    rms = number(dig(result, "result", "rms_calibrated")) if aside is None else aside
    tracker = number(dig(result, "uncertainty", "tracker", "sigma_3d"))
    names = {"predicted_error_95_m": predicted, "held_out_rms_m": rms, "tracker_sigma_3d_m": tracker}
    words = []
    if predicted is not None:
        words.append(
            f"95 % of prediction errors through noise of the readings below {1e3 * predicted:.4f} mm in the "
            "sampled joint ranges; what the arm's model lacks is not in it"
        )
    if rms is not None:
        words.append(f"{1e3 * rms:.4f} mm RMS on held-out poses")
    if tracker is not None:
        given = dig(result, "result", "noise", "given") is not False
        whose = "the tracker's own noise is" if given else "readings scatter about the calibrated arm by"
        words.append(f"{whose} {1e3 * tracker:.4f} mm")
    found = {key: v for key, v in names.items() if v is not None}
    return found, "; ".join(words) or "the result states no uncertainty"
