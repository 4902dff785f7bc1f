"""The figures of a crossed-beam solution as a result document."""

from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.lengths import length95
from calibration.tool_frame.beams import FoundBeams
from calibration.tool_frame.centres import centre
from calibration.tool_frame.checks import Residuals
from calibration.tool_frame.classic import Classic
from calibration.tool_frame.crossings import Crossing
from calibration.tool_frame.geometry import BEAMS, rotated
from calibration.tool_frame.lateral import Lateral
from calibration.tool_frame.out_and_back import UNSEEN_DELAY
from calibration.tool_frame.scene import ToolFrameScene
from calibration.tool_frame.solution import Solution
from cell.formats.laser import LaserData
from cell.formats.result import Empty, Warning_
from cell.poses import Array
from procedures.laser.result import (
    BeamLine,
    BeamUncertainty,
    LaserAnswer,
    LaserHeldOut,
    LaserInputs,
    LaserObservability,
    LaserResiduals,
    LaserResult,
    LaserUncertainty,
    OutBack,
    PassResidual,
    Plane,
    ReferenceAnswer,
    ReferenceObservability,
    ReferenceResiduals,
    ReferenceResult,
    ReferenceUncertainty,
    RejectedPass,
    RejectedReferencePass,
    SetName,
)
from procedures.report.numbers import K95

SPEED_CODE, BLUNDER_CODE, UNUSED_CODE = "laser.speed", "laser.rejected", "laser.not-used"

_SWITCHING = "hysteresis: with one speed it is part of tau"
_CLEARING = "clearing later than breaking: part of the chord, unless two speeds cross the tool's full width"


def fill_result(
    scene: ToolFrameScene,
    solution: Solution,
    classic: Classic | None,
    rest: Residuals,
    checks: Residuals | None,
    warnings: list[tuple[str, str]],
    inputs: LaserInputs,
) -> LaserResult:
    """The document of kind ``laser``."""
    dp = solution.dp if classic is None else classic.dp
    drot = solution.drot if classic is None else None
    lateral = solution.lateral
    answer = LaserAnswer(
        dp_flange=dp.tolist(),
        drot_flange=None if drot is None else drot.tolist(),
        flange_offset_base=(-scene.R @ dp).tolist(),
        p_new=(scene.tool.p + dp).tolist(),
        axis_new=None if drot is None else rotated(scene.tool.axis, drot).tolist(),
        tau=None if UNSEEN_DELAY in solution.undetermined else _tau(lateral),
        hysteresis_m=lateral.value("hysteresis"),
        lag_s=lateral.value("lag"),
        cov=solution.cov.tolist() if classic is None else None,
        rejected=_rejected(scene, solution),
    )
    if classic is not None:
        answer = answer.changed(
            flange_offset_base=classic.offset.tolist(), source_rule_dp=classic.source_rule.tolist()
        )
        warnings = [*warnings, ("laser.classic", "the classic method gives no uncertainty")]
    warnings = [*warnings, *_selection_warnings(scene, solution)]
    return LaserResult(
        verdict="warn" if warnings else "pass",
        warnings=Warning_.each(warnings),
        result=answer,
        uncertainty=_uncertainty(scene, solution) if classic is None else LaserUncertainty(),
        residuals=_residuals(scene, solution, rest),
        heldout=LaserHeldOut()
        if checks is None
        else LaserHeldOut(
            rms_m=checks.rms,
            expected_m=checks.expected,
            edges=len(checks.rest),
            passes=len(set(checks.source.tolist())),
        ),
        observability=_observability(solution),
        inputs=inputs,
    )


def _tau(lateral: Lateral) -> float | None:
    """The delay now, where the reference had another one."""
    now = lateral.value("tau_current")
    return lateral.value("tau") if now is None else now


def _uncertainty(scene: ToolFrameScene, solution: Solution) -> LaserUncertainty:
    a = scene.tool.axis
    flat = np.eye(3) - np.outer(a, a)
    point = solution.cov[:3, :3]
    return LaserUncertainty(
        U_xy_m=length95(flat @ point @ flat),
        U_z_m=None if solution.z_sigma is None else K95 * solution.z_sigma,
        U_point_m=length95(point),
        U_tilt_rad=None if solution.drot is None else length95(solution.cov[3:, 3:]),
        sigma_m=np.sqrt(np.diag(point)).tolist(),
        sigma_rad=np.sqrt(np.diag(solution.cov)[3:]).tolist(),
        sigma_tau_s=solution.lateral.deviation("tau"),
        sigma_hysteresis_m=solution.lateral.deviation("hysteresis"),
        sigma_lag_s=solution.lateral.deviation("lag"),
        noise_m=solution.lateral.noise.sigma,
        effective_points=solution.lateral.effective,
    )


def _rejected(scene: ToolFrameScene, solution: Solution) -> list[RejectedPass]:
    """Every pass that tells nothing across the beams, with the reason; misses are not among them."""
    reasons = {**solution.selection.reasons, **solution.rejected}
    return [
        RejectedPass(
            set=_set_of(scene, k),
            index=scene.passes[k].index,
            beam=scene.passes[k].beam,
            reason=reason,
        )
        for k, reason in sorted(reasons.items())
    ]


def _set_of(scene: ToolFrameScene, k: int) -> SetName:
    return "current" if scene.passes[k].current else "reference"


def _selection_warnings(scene: ToolFrameScene, solution: Solution) -> list[tuple[str, str]]:
    found = []
    speed = [k for k, r in solution.selection.reasons.items() if r.startswith("the speed")]
    if speed:
        found.append(
            (SPEED_CODE, f"{len(speed)} passes were not used, as the speed changed: {_named(scene, speed)}")
        )
    bad = sorted(k for k, reason in solution.rejected.items() if not reason.startswith("met the tip"))
    if bad:
        found.append(
            (
                BLUNDER_CODE,
                f"{len(bad)} passes disagree with the others and do not count across the beams: "
                f"{_named(scene, bad)}",
            )
        )
    rest = [k for k in solution.selection.reasons if k not in solution.selection.grazing and k not in speed]
    if rest:
        found.append(
            (UNUSED_CODE, f"{len(rest)} passes could not be used; 'rejected' says why: {_named(scene, rest)}")
        )
    return found


def _named(scene: ToolFrameScene, places: list[int]) -> str:
    names = [scene.passes[k].name for k in sorted(places)]
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _residuals(scene: ToolFrameScene, solution: Solution, rest: Residuals) -> LaserResiduals:
    lateral = solution.lateral
    value = {name: float(lateral.linear[k]) for k, name in enumerate(lateral.model.names)}
    now = {**value, "tau": value.get("tau_current", value["tau"])}
    centres = {k: centre(c, now if c.source.current else value) for k, c in solution.seen.crossings.items()}
    return LaserResiduals(
        rms_m=rest.rms,
        expected_m=rest.expected,
        per_pass=[
            _pass_line(scene, k, c, rest, centres[k], lateral.narrower.get(k))
            for k, c in sorted(solution.seen.crossings.items())
        ],
        out_back=[
            OutBack(
                set=_set_of(scene, a),
                beam=scene.passes[a].beam,
                indices=[scene.passes[a].index, scene.passes[b].index],
                m=centres[a] - centres[b],
            )
            for a, b in _pairs(scene, solution)
        ],
    )


def _pass_line(
    scene: ToolFrameScene, k: int, c: Crossing, rest: Residuals, centre: float, narrower: float | None
) -> PassResidual:
    own = rest.rest[rest.source == k]
    return PassResidual(
        set=_set_of(scene, k),
        index=scene.passes[k].index,
        beam=scene.passes[k].beam,
        dir=scene.passes[k].direction,
        above_m=float(np.mean(c.above)),
        edges=c.edges,
        chord_m=c.chord,
        speed_m_s=c.speed,
        speed_change=max(c.speed_change, 0.0) if np.isfinite(c.speed_change) else None,
        centre_m=centre,
        used=bool(len(own)),
        rms_m=float(np.sqrt(np.mean(own**2))) if len(own) else None,
        narrower_m=narrower,
    )


def _pairs(scene: ToolFrameScene, solution: Solution) -> list[tuple[int, int]]:
    used = sorted(
        set(solution.lateral.rows.source.tolist()),
        key=lambda k: (scene.passes[k].current, scene.passes[k].beam, float(scene.passes[k].pose_t[0])),
    )
    found = []
    for a, b in pairwise(used):
        p, q = scene.passes[a], scene.passes[b]
        if (p.beam, p.current, p.direction, q.direction) == (q.beam, q.current, 1, -1):
            found.append((a, b))
    return found


def _observability(solution: Solution) -> LaserObservability:
    model = solution.lateral.model
    spin, tilt = 1, 0 if solution.drot is not None else 2
    height = 1 if solution.z_sigma is None else 0
    unseen = ([] if model.several_speeds else [_SWITCHING]) + ([] if model.lag else [_CLEARING])
    return LaserObservability(
        rank=6 - spin - tilt - height,
        of=6,
        undetermined=[*solution.undetermined, *unseen],
        unknowns=model.names,
        own_tilt_rad={b: solution.lateral.value(f"own tilt {b}") for b in model.own_tilts},
        edges_m={b: solution.lateral.edges(b).tolist() for b in BEAMS},
        heights_m={
            f"{'current' if current else 'reference'} {beam}": [height, sigma]
            for (beam, current), (height, sigma) in solution.heights.items()
        },
        lever_m=dict(solution.lever),
    )


def fill_reference(
    data: LaserData, found: FoundBeams, warnings: list[tuple[str, str]], inputs: LaserInputs
) -> ReferenceResult:
    """The document of kind ``laser-reference``."""
    R = np.asarray(_matrix(data))
    point = R.T @ found.cov @ R
    cov = np.zeros((6, 6))
    cov[:3, :3] = point
    answer = ReferenceAnswer(
        beams={
            b: BeamLine(point=f.line.point.tolist(), dir=f.line.direction.tolist())
            for b, f in found.beams.items()
        },
        hits={b: f.hit.tolist() for b, f in found.beams.items()},
        tau=found.tau,
        hysteresis_m=found.hysteresis,
        lag_s=found.lag,
        plane=Plane(
            gap_m=found.plane_gap,
            U_gap_m=found.U_plane_gap,
            slope_rad={b: f.slope for b, f in found.beams.items()},
        ),
        axis_turn_flange=None if found.axis_turn is None else found.axis_turn.tolist(),
        cov=cov.tolist(),
    )
    gaps = np.array(list(found.out_back.values()))
    return ReferenceResult(
        verdict="warn" if warnings else "pass",
        warnings=Warning_.each(warnings),
        result=answer,
        uncertainty=ReferenceUncertainty(
            U_point_m=length95(found.cov),
            sigma_tau_s=found.sigma_tau,
            beams={
                b: BeamUncertainty(
                    sigma_point_m=np.sqrt(np.diag(f.cov_point)).tolist(),
                    sigma_dir=np.sqrt(np.diag(f.cov_direction)).tolist(),
                    places_apart_m=f.apart,
                )
                for b, f in found.beams.items()
            },
            noise_m=found.noise,
        ),
        residuals=ReferenceResiduals(
            out_back_rms_m=float(np.sqrt(np.mean(gaps**2))) if len(gaps) else None,
            out_back_max_m=float(np.max(np.abs(gaps))) if len(gaps) else None,
            chord_m=dict(found.chords),
            rejected=[
                RejectedReferencePass(
                    index=found.scene.passes[k].index, beam=found.scene.passes[k].beam, reason=r
                )
                for k, r in sorted({**found.selection.reasons, **found.rejected}.items())
            ],
        ),
        observability=ReferenceObservability(
            undetermined=["spin about the tool's axis"]
            + ([] if found.hysteresis is not None else [_SWITCHING])
            + ([] if found.lag is not None else [_CLEARING])
        ),
        heldout=Empty(),
        inputs=inputs,
    )


def _matrix(data: LaserData) -> Array:
    return np.asarray(Rotation.from_rotvec(data.R_base_flange).as_matrix())
