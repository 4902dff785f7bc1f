"""What a job plugs in: each kind of result with its jobs, words, report, solver and comparison.

References are ``"package.module:name"`` and are imported when they are used, so this table imports no job.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib import import_module
from typing import Any

GENERAL_PLAN = "procedures.plan_words:plan_lines"
PLAIN_RESULT = "cell.formats.result:Result"
PLAIN_REPORT = "procedures.report.plain:PLAIN"


@dataclass(frozen=True)
class Argument:
    """A number that a PLC gives with the start of a job: a key of the job's section, for that run alone.

    ``place``, 1 to 3, says in which argument registers it stands, and ``type`` (uint32 or float32) how they
    are read; on CAN there is the first alone. 0 leaves the key as it is configured. Bounds, default and
    meaning are those of the key. ``words``: what the numbers from 1 stand for, of a key that takes words.
    """

    key: str
    place: int
    type: str = "uint32"
    words: tuple[str, ...] = ()


@dataclass(frozen=True)
class Kind:
    """One kind of result document and of plan; an empty reference: there is no such thing for this kind.

    ``result`` is the model of its documents with an answer, a subclass of ``cell.formats.result.Envelope``.
    ``words``: ``result -> lines``, of an answer; ``plan``: ``plan -> lines``; ``report``: a ``Layout``;
    ``solve``: ``(path, *, method, progress, **asked) -> result``, for a data set without its run, where
    ``asked`` are the further options that it takes; ``compare``: ``(first, second, false_alarm) ->
    Comparison``.
    ``expectation``: ``(setup, config) -> figures`` of what a configured job can reach, with ``text``,
    ``problems`` and ``cautions``; ``truth``: ``(result, truth, folder) -> Judged`` beside a twin's truth;
    ``rehearsal``: ``(setup, config) -> Rehearsal``, what a twin needs for it;
    ``live`` and ``live_page``: ``(numbers, rows) -> line`` and ``(title, rows, reload_s) -> HTML`` of a run
    that goes on. ``data_file`` is the data set in a run folder, and ``arguments`` are what its jobs take from
    a PLC. ``measures`` are the calibrations that its jobs measure, named without a tool or a device;
    ``values``: schemas of what it puts into the ledger as a document, and ``document -> line`` of each.
    ``judges``: a run that passes says that the one in effect still holds. ``trend_limits``: trends, without
    the names that they end with, and the key of the job's section that bounds their size. A reference that
    begins with ":" is in ``module``.
    """

    name: str
    words: str
    result: str = PLAIN_RESULT
    data_file: str = ""
    jobs: tuple[str, ...] = ()  # their classes
    plan: str = GENERAL_PLAN
    report: str = PLAIN_REPORT
    solve: str = ""
    asked: tuple[str, ...] = ()
    compare: str = ""
    expectation: str = ""
    truth: str = ""
    rehearsal: str = ""
    live: str = ""
    live_page: str = ""
    arguments: tuple[Argument, ...] = ()
    measures: tuple[str, ...] = ()
    values: tuple[tuple[str, str], ...] = ()
    judges: bool = False
    trend_limits: tuple[tuple[str, str], ...] = ()
    module: str = ""

    def __post_init__(self) -> None:
        for part in fields(self):
            reference = getattr(self, part.name)
            if isinstance(reference, str) and reference.startswith(":"):
                object.__setattr__(self, part.name, self.module + reference)
        object.__setattr__(self, "jobs", tuple(map(self._whole, self.jobs)))
        values = tuple((schema, self._whole(words)) for schema, words in self.values)
        object.__setattr__(self, "values", values)

    def _whole(self, reference: str) -> str:
        return self.module + reference if reference.startswith(":") else reference


_ALL = (
    Kind(
        name="hand-eye",
        words="procedures.hand_eye.words:hand_eye_lines",
        result="procedures.hand_eye.result:HandEyeResult",
        data_file="capture.json",
        jobs=("procedures.hand_eye.cone_capture:ConeCapture",),
        plan="procedures.hand_eye.words:cone_plan_lines",
        report="procedures.hand_eye.report.layout:HAND_EYE",
        solve="procedures.hand_eye.solve.solver:solve_hand_eye",
        asked=("predict", "robot"),
        compare="procedures.hand_eye.comparison:compare_hand_eye",
        expectation="procedures.hand_eye.expectation:cone_expectation",
        truth="procedures.hand_eye.truth:judge_camera",
        rehearsal="procedures.hand_eye.rehearsal:rehearse_cone",
        measures=("T_flange_camera", "T_base_camera"),
        trend_limits=(
            ("hand_eye.spread_within_m", "accept.max_spread_within_t_m"),
            ("hand_eye.spread_across_m", "accept.max_spread_across_t_m"),
        ),
    ),
    Kind(
        name="axbc",
        words="procedures.eye_to_hand.words:axbc_lines",
        result="procedures.eye_to_hand.result:AxbcResult",
        data_file="axbc.json",
        jobs=("procedures.eye_to_hand.check:EyeToHandCheck",),
        plan="procedures.eye_to_hand.words:axbc_plan_lines",
        report="procedures.eye_to_hand.report.layout:EYE_TO_HAND",
        solve="procedures.eye_to_hand.solve.solver:solve_axbc",
        asked=("targets",),
        expectation="procedures.eye_to_hand.expectation:eye_to_hand_expectation",
        truth="procedures.eye_to_hand.truth:judge_standard",
        rehearsal="procedures.eye_to_hand.rehearsal:rehearse_check",
        measures=("T_base_camera",),
        judges=True,
    ),
    Kind(
        name="laser-reference",
        words="procedures.laser.words:reference_lines",
        result="procedures.laser.result:ReferenceResult",
        data_file="laser.json",
        jobs=("procedures.laser.reference:LaserReference",),
        plan="procedures.laser.plan_words:sweep_plan_lines",
        report="procedures.laser.report.layout:LASER",
        expectation="procedures.laser.expectation:laser_expectation",
        truth="procedures.laser.truth:judge_beams",
        rehearsal="procedures.laser.rehearsal:rehearse_reference",
        measures=("laser_reference",),
        values=(
            ("cellward.laser-reference/1", "procedures.laser.words:reference_value"),
            ("cellward.laser-reference/2", "procedures.laser.words:reference_value"),
        ),
    ),
    Kind(
        name="laser",
        words="procedures.laser.words:laser_lines",
        result="procedures.laser.result:LaserResult",
        data_file="laser.json",
        jobs=("procedures.laser.check:LaserCheck", "procedures.laser.update:LaserUpdate"),
        plan="procedures.laser.plan_words:sweep_plan_lines",
        report="procedures.laser.report.layout:LASER",
        solve="procedures.laser.solve.solver:solve_laser",
        compare="procedures.laser.comparison:compare_laser",
        truth="procedures.laser.truth:judge_tool",
        rehearsal="procedures.laser.rehearsal:rehearse_measurement",
        measures=("T_flange_tool",),
        judges=True,
        trend_limits=(
            ("tool.offset_x_m", "against_reference.max_shift_m"),
            ("tool.offset_y_m", "against_reference.max_shift_m"),
            ("tool.offset_z_m", "against_reference.max_shift_m"),
        ),
    ),
    Kind(
        name="kincal",
        words="procedures.tracker.words:kincal_lines",
        result="procedures.tracker.result:KincalResult",
        data_file="kincal.json",
        jobs=("procedures.tracker.procedure:TrackerSampling",),
        plan="procedures.tracker.plan_words:tracker_plan_lines",
        report="procedures.tracker.report.layout:KINCAL",
        solve="procedures.tracker.solve.solver:solve_kincal",
        asked=("predict", "targets", "robot"),
        compare="procedures.tracker.comparison:compare_arms",
        expectation="procedures.tracker.expectation:tracker_expectation",
        truth="procedures.tracker.truth:judge_arm",
        rehearsal="procedures.tracker.rehearsal:rehearse_sampling",
        measures=("kinematics",),
        values=(("cellward.kinematics/1", "procedures.tracker.words:kinematics_value"),),
        trend_limits=(("tracker.drift_m", "max_drift_m"),),
    ),
    Kind(
        name="belt-calibration",
        words="procedures.belt.words:belt_calibration_lines",
        result="procedures.belt.result:BeltCalibrationResult",
        data_file="belt.json",
        jobs=("procedures.belt.calibrating.procedure:BeltCalibration",),
        report="procedures.belt.report.calibration:BELT_CALIBRATION",
        expectation="procedures.belt.calibrating.expectation:calibration_expectation",
        truth="procedures.belt.truth:judge_belt",
        rehearsal="procedures.belt.rehearsal:rehearse_calibration",
        measures=("belt",),
    ),
    Kind(
        name="belt-tracking",
        words="procedures.belt.words:belt_tracking_lines",
        result="procedures.belt.result:BeltTrackingResult",
        data_file="intercept.json",
        jobs=("procedures.belt.tracking:BeltTracking",),
        report="procedures.belt.report.layout:BELT_TRACKING",
        expectation="procedures.belt.expectation:belt_expectation",
        truth="procedures.belt.truth:judge_picks",
        rehearsal="procedures.belt.rehearsal:rehearse_picking",
        live="procedures.belt.live_words:live_line",
        live_page="procedures.belt.report.live:live_page",
        arguments=(Argument("picks", 1), Argument("first_place", 2)),
    ),
    Kind(
        name="intercept",
        words="procedures.belt.intercept_words:intercept_lines",
        result="procedures.belt.result:InterceptResult",
        data_file="intercept.json",
        solve="procedures.belt.solve.solver:solve_intercept",
    ),
    Kind(
        name="slot",
        words="procedures.slot.words:slot_lines",
        result="procedures.slot.result:SlotResult",
        data_file="slot.json",
        jobs=("procedures.slot.procedure:SlotInsertion",),
        plan="procedures.slot.words:slot_plan_lines",
        report="procedures.slot.report:SLOT",
        expectation="procedures.slot.expectation:slot_expectation",
        truth="procedures.slot.truth:judge_slot",
        rehearsal="procedures.slot.rehearsal:rehearse_slot",
        arguments=(Argument("slot", 1), Argument("action", 2, words=("insert", "pull", "replace"))),
    ),
    Kind(
        name="latency",
        words="procedures.latency.words:latency_lines",
        result="procedures.latency.result:LatencyResult",
        data_file="latency.json",
        jobs=("procedures.latency.procedure:LatencyCalibration",),
        plan="procedures.laser.plan_words:sweep_plan_lines",
        truth="procedures.latency.truth:judge_delay",
        report="procedures.latency.report:LATENCY",
        expectation="procedures.latency.expectation:delay_expectation",
        rehearsal="procedures.latency.rehearsal:rehearse_delay",
        measures=("time_offset_s",),
        trend_limits=(
            ("beams.latency_s", "accept.max_offset_s"),
            ("flange_camera.latency_s", "accept.max_offset_s"),
            ("fixed_camera.latency_s", "accept.max_offset_s"),
            ("belt.latency_s", "accept.max_offset_s"),
        ),
    ),
    Kind(
        name="corrected-targets",
        words="procedures.corrected_targets.words:targets_lines",
        result="procedures.corrected_targets.result:TargetsResult",
        data_file="corrected-targets.json",
        jobs=("procedures.corrected_targets.procedure:HandTargets",),
        plan="procedures.corrected_targets.words:targets_plan_lines",
        report="procedures.corrected_targets.report:TARGETS",
        expectation="procedures.corrected_targets.expectation:targets_expectation",
        truth="procedures.corrected_targets.truth:judge_targets",
        rehearsal="procedures.corrected_targets.rehearsal:rehearse_targets",
    ),
    Kind(
        name="touch-test",
        words="procedures.touch_test.words:touch_lines",
        result="procedures.touch_test.result:TouchResult",
        data_file="touch-test.json",
        jobs=("procedures.touch_test.procedure:TouchTest",),
        report="procedures.touch_test.report:TOUCH",
        solve="procedures.touch_test.judging:solve_touch_test",
        expectation="procedures.touch_test.expectation:touch_expectation",
        truth="procedures.touch_test.truth:judge_touch",
        rehearsal="procedures.touch_test.rehearsal:rehearse_touch",
    ),
    Kind(
        name="cross-check",
        words="procedures.cross_check.words:cross_check_lines",
        result="procedures.cross_check.result:CrossCheckResult",
        data_file="cross-check.json",
        report="procedures.cross_check.report:CROSS_CHECK",
        solve="procedures.cross_check.solver:solve_cross_check",
    ),
    Kind(
        name="iso9283",
        words="procedures.iso9283.words:iso9283_lines",
        result="procedures.iso9283.result:Iso9283Result",
        data_file="iso9283.json",
        jobs=("procedures.iso9283.procedure:Iso9283Test",),
        plan="procedures.iso9283.words:iso9283_plan_lines",
        report="procedures.iso9283.report.layout:ISO9283",
        compare="procedures.iso9283.comparison:compare_iso9283",
        expectation="procedures.iso9283.expectation:iso9283_expectation",
        truth="procedures.iso9283.truth:judge_iso9283",
        rehearsal="procedures.iso9283.rehearsal:rehearse_test",
        trend_limits=(
            ("iso9283.AP_m", "max_AP_m"),
            ("iso9283.RP_m", "max_RP_m"),
        ),
    ),
)
KINDS: Mapping[str, Kind] = {kind.name: kind for kind in _ALL}


OUTSIDE: dict[str, Kind] = {}  # kinds of other packages


def add_outside(name: str) -> None:
    """Make the kind ``"package.module:NAME"`` of a job known; ``LookupError`` when there is none such."""
    if name in KINDS:
        return
    try:
        found = load(name)
    except Exception as exc:  # whatever another package does while it is imported
        raise LookupError(f"its kind '{name}' cannot be loaded: {exc}") from exc
    if not isinstance(found, Kind) or found.name != name:
        raise LookupError(f"its kind '{name}' is no Kind whose name is '{name}'")
    OUTSIDE[name] = found


def load(reference: str) -> Any:
    """What ``"package.module:name"`` refers to."""
    module, name = reference.split(":")
    return getattr(import_module(module), name)
