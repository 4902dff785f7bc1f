"""The verdict of a sampling: the solver's answer held against the poses set aside and the limits of the job.

Pure but for reading the data sets: the job and ``cellward replay`` come to the same document.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtri

from calibration.identification.held_out import rms
from calibration.identification.registration import register
from calibration.kinematics.families import arm_spec
from cell.errors import present
from cell.formats.result import Result, Warning_
from cell.formats.robot import parse_robot
from cell.poses import Array, from_pose6, to_pose6
from cell.store.files import read_json
from procedures.tracker.record import HELD_OUT_FILE
from procedures.tracker.result import (
    Accuracy,
    AsideSample,
    KincalAnswer,
    KincalResult,
    Monuments,
    Off,
    Sampling,
    SetAside,
)
from procedures.tracker.solve.solver import solve_kincal

VALUE_SCHEMA = "cellward.kinematics/1"
_MANY_LOST = 0.1
_SURPRISE = 1e-3  # chance of poses set aside so far off, were noise and prediction as they are said to be
# 95 % of 3D errors stay below so many times their RMS: where they are alike in all directions, and where all
# are along one, which no shape of them exceeds.
_P95_ROUND, _P95_MOST = float(np.sqrt(chdtri(3, 0.05) / 3.0)), float(np.sqrt(chdtri(1, 0.05)))


def solve_within_limits(path: Path, limit_m: float, method: str | None = None) -> KincalResult | Result:
    """The result of a run's ``kincal.json``, judged; for the worker process."""
    return judged(solve_kincal(path, method=method, calls=1), path, limit_m)


def judged(found: KincalResult | Result, path: Path, limit_m: float) -> KincalResult | Result:
    """``found`` with what the poses set aside say, with the facts of the run and the verdict on both.

    A result beyond a limit stays filled, and the reason names the limit.
    """
    data, aside = read_json(path), read_json(path.parent / HELD_OUT_FILE)
    facts = Sampling.model_validate(data["notes"]["sampling"])
    if not isinstance(found, KincalResult):
        return found.changed(inputs=found.inputs.model_copy(update={"sampling": facts}))
    found, answer, heldout = found.with_inputs(sampling=facts), found.result, found.heldout
    if aside["samples"]:
        heldout = heldout.changed(set_aside=set_aside(answer, data, aside, heldout.tracker_3d))
    off = heldout.best().rms
    worst = present(found.uncertainty.predicted_95, "prediction of a solved arm").workspace.max
    accuracy = Accuracy(
        before=off.registration_only,
        after=off.calibrated,
        predicted_95=worst,
        direction="of reflectors in the tracker frame; before: the nominal arm in its best place, after: "
        "on poses that the solver did not see, the tracker's noise included",
    )
    reasons = [*_beyond(heldout.set_aside, worst, limit_m), *_moved(facts.monuments)]
    warnings = _warnings(heldout.set_aside, worst, facts)
    told = found.changed(result=answer.changed(absolute_accuracy=accuracy), heldout=heldout)
    told = told.judged(reasons, Warning_.each(warnings))
    return told.changed(reasons=[*told.reasons, *(text for _, text in warnings)])


def set_aside(
    answer: KincalAnswer, solved: Mapping[str, Any], aside: Mapping[str, Any], tracker_3d: float
) -> SetAside:
    """Distances (m) of the readings set aside from where the exported arm, and the nominal one, predict them.

    The nominal arm once in the place of the tracker that the calibrated one found, and once in the place that
    suits the solved readings best.
    """
    T_tracker_base = from_pose6(answer.T_tracker_base)
    p = _with_right_constant(answer, aside["samples"])
    calibrated = T_tracker_base.apply(places(answer.robot, aside["samples"]))
    nominal = places(solved["robot"], aside["samples"])
    p_solved = _with_right_constant(answer, solved["samples"]).T
    best = register(p_solved, places(solved["robot"], solved["samples"]).T, np.ones(p_solved.shape[1]))
    off = {
        "nominal": np.linalg.norm(T_tracker_base.apply(nominal) - p, axis=1),
        "registration_only": np.linalg.norm(best.to_tracker(nominal.T).T - p, axis=1),
        "calibrated": np.linalg.norm(calibrated - p, axis=1),
    }
    return SetAside(
        samples=len(p),
        rms=Off(**{name: rms(d) for name, d in off.items()}),
        max=Off(**{name: float(d.max()) for name, d in off.items()}),
        tracker_3d=tracker_3d,
        per_sample=[
            AsideSample(
                index=s["index"], target=s["target"], **{name: float(d[k]) for name, d in off.items()}
            )
            for k, s in enumerate(aside["samples"])
        ],
        meaning="distance (m) of readings that were set aside before solving from their prediction; the "
        "tracker's own noise (tracker_3d, RMS) is in it",
    )


def _with_right_constant(answer: KincalAnswer, samples: list[Any]) -> Array:
    """(n, 3): readings without what was found of the reflector's constant."""
    p = np.array([s["p_tracker"] for s in samples])
    constant_m = present(answer.reflector_constant_m, "constant of a solved arm")
    out: Array = p * (1.0 - constant_m / np.linalg.norm(p, axis=1, keepdims=True))
    return out


def places(robot: Mapping[str, Any], samples: list[Any]) -> Array:
    """(n, 3): where a ROBOT has the reflectors of ``samples``, in its base."""
    spec = arm_spec(parse_robot(robot, "robot"))
    flange = spec.arm.base.flange(np.array([s["q"] for s in samples]))
    tools = np.array([spec.tools[s["target"]] for s in samples])
    out: Array = np.einsum("nij,nj->ni", flange[:, :3, :3], tools) + flange[:, :3, 3]
    return out


def _beyond(aside: SetAside | None, predicted_95: float, limit: float) -> list[str]:
    reasons = []
    if not predicted_95 <= limit:
        reasons.append(
            f"max_error_m: at the worst place 95 % of the prediction errors stay below "
            f"{1e3 * predicted_95:.3g} mm, the limit is {1e3 * limit:g} mm"
        )
    if aside is not None and aside.rms.calibrated is not None:
        own = float(np.sqrt(max(aside.rms.calibrated**2 - aside.tracker_3d**2, 0.0)))
        if (bound := _P95_MOST * own) > limit:
            reasons.append(
                f"max_error_m: readings that were set aside are {1e3 * own:.3g} mm off their prediction (RMS "
                f"beyond the tracker's own noise), so 95 % of errors stay below {1e3 * bound:.3g} mm; "
                f"the limit is {1e3 * limit:g} mm"
            )
    return reasons


def _moved(monuments: Monuments | None) -> list[str]:
    if monuments is None or not monuments.beyond_limit:
        return []
    return [
        f"max_drift_m: a monument was seen {1e3 * monuments.max_moved_m:.3f} mm from where it was at "
        f"first, the limit is {1e3 * monuments.limit_m:g} mm"
    ]


def _warnings(aside: SetAside | None, predicted_95: float, facts: Sampling) -> list[tuple[str, str]]:
    out: list[tuple[str, str]] = []
    monuments = facts.monuments
    if monuments is None:
        out.append(
            ("tracker.no-monuments", "no monument was looked at, so nothing says that the stand stood")
        )
    else:
        if monuments.beyond_noise and not monuments.beyond_limit:
            text = f"monuments moved by up to {1e3 * monuments.max_moved_m:.3f} mm, which is within the limit"
            out.append(("tracker.drift", f"{text}, but more than noise"))
        if late := monuments.samples_since_last_look:
            out.append(("tracker.not-looked", f"after the last {late} poses no monument was looked at"))
    if aside is None:
        out.append(("heldout.none-aside", "no pose was set aside, so only the folds judge the result"))
    else:
        # Poses chosen for what they tell lie at the edges, where predictions are worst.
        expected = float(np.hypot(aside.tracker_3d, predicted_95 / _P95_ROUND))
        free = 3 * aside.samples
        most = expected * float(np.sqrt(chdtri(free, _SURPRISE) / free))
        if (found := aside.rms.calibrated) is not None and found > most:
            text = f"readings that were set aside are {1e3 * found:.3f} mm off (RMS)"
            out.append(("heldout.surprise", f"{text}; noise explains up to {1e3 * most:.3f} mm"))
    if off_plan := facts.off_plan:
        text = f"{off_plan} of {facts.measured} poses were measured elsewhere than was asked"
        out.append(("samples.off-plan", f"{text}, so the result may be worse than was planned"))
    if doubtful := facts.doubtful:
        said = "; ".join(dict.fromkeys(w for s in doubtful for w in s.warnings))
        text = f"at {len(doubtful)} of {facts.measured} poses the tracker warned: {said}"
        out.append(("tracker.doubtful", text))
    if facts.wanted - facts.measured > _MANY_LOST * facts.wanted:
        out.append(("samples.lost", f"{facts.measured} of {facts.wanted} wanted poses could be measured"))
    return out


def proposal_value(result: KincalResult, payload_kg: float, robot: Mapping[str, Any]) -> dict[str, Any]:
    """What ``kinematics.<device>`` holds: the calibrated ROBOT, where the tracker stood, and how good it is.

    ``robot`` is what the controller believes, ``serials`` which arm and which tracker it was. Lengths in
    metres.
    """
    answer, found = result.result, result.heldout.best()
    sampling = present(result.inputs.sampling, "sampling of a run")
    accuracy = present(answer.absolute_accuracy, "accuracy of a judged run")
    return {
        "schema": VALUE_SCHEMA,
        "robot": answer.robot,
        "controller": dict(robot),
        "T_base_tracker": [float(v) for v in to_pose6(from_pose6(answer.T_tracker_base).inv())],
        "payload_kg": payload_kg,
        "serials": sampling.serials or {},
        "joint_ranges_rad": sampling.joint_ranges_rad,
        "joints_sampled_rad": sampling.joints_sampled_rad,
        "rank": answer.rank,
        "unidentifiable": answer.unidentifiable,
        "rms_registration_only": found.rms.registration_only,
        "rms_calibrated": found.rms.calibrated,
        "held_out": found.samples,
        "tracker_3d": found.tracker_3d,
        "predicted_95": accuracy.predicted_95,
    }
