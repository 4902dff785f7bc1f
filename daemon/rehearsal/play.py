"""Play the runs of a rehearsal on virtual time, and tell what came of the last one."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from cell.errors import CellError
from cell.known_cell import KnownDelay
from cell.store.runs import RunFolder, list_runs, load_run
from daemon.config import CellConfig
from daemon.demo.ending import beside_truth
from daemon.demo.fast import run_objects
from daemon.demo.steps import Bump, Step
from daemon.predictions import prediction_of
from daemon.rehearsal.objects import RehearsedCell, rehearsed_cell
from procedures.beside_truth import Judged
from procedures.documents import kind_of, read_result
from procedures.kind import load
from procedures.rehearsal import Rehearsal

NOT_STARTED = "not started"
INTERRUPTED = "interrupted"
NOT_WELL = "{}, which has to come first, did not end well"
BUMP = Bump((0.0012, -0.0007, 0.0005), (0.008, -0.006))


@dataclass(frozen=True)
class RehearsedRun:
    """How a job ended in one twin; ``ended`` is ``NOT_STARTED`` where what comes first kept it from starting.

    ``seconds`` are the cell's, not the computer's. ``stated`` is what the job says of its result, ``off`` how
    far the result is from the twin's truth; ``good`` whether the two agree, ``inside95`` whether each error
    is below the 95 % limit that was stated, None where none was, and ``of95`` each error in units of that
    limit; ``limits95`` are those limits that have a unit, with it. Of a kind that no truth can judge ``good``
    is None, and there are ``expected``, what was predicted, and ``told``, the result in words.
    ``before`` are the jobs that were played before this one, each with its verdict, else with how it ended.
    ``why`` has the result's reasons, ``warnings`` the texts of its warnings that are no reason, ``uncovered``
    what the limits that it states do not cover. ``lost`` are poses and passes that fell out, with the reason;
    ``report`` is a file. ``not_in_twin`` are keys of the cell's devices that the twin does not have.
    """

    seed: int
    ended: str
    seconds: float
    verdict: str = ""
    stated: str = ""
    off: str = ""
    good: bool | None = False
    inside95: bool | None = None
    of95: dict[str, float] = field(default_factory=dict)
    limits95: dict[str, tuple[float, str]] = field(default_factory=dict)
    expected: str = ""
    told: list[str] = field(default_factory=list)
    before: dict[str, str] = field(default_factory=dict)
    why: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    uncovered: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    report: str = ""
    not_in_twin: list[str] = field(default_factory=list)

    @property
    def succeeded(self) -> bool:
        return self.ended == "complete" and self.verdict in ("pass", "warn") and self.good is not False

    def as_dict(self) -> dict[str, Any]:
        return {**asdict(self), "succeeded": self.succeeded}


def rehearse(
    config: CellConfig, path: Path, job: str, seed: int, folder: Path, tool: str | None = None
) -> RehearsedRun:
    """``job`` with ``tool`` in a twin drawn by ``seed``; its files stay in ``folder``.

    A job that the twin refuses is an outcome. Errors as of ``rehearsed_cell``.
    """
    cell = rehearsed_cell(config, path, job, seed, folder, tool)
    outcome = _played(config, cell, job, seed, tool)
    return replace(outcome, before=_played_before(cell), not_in_twin=list(cell.missing))


def _played(config: CellConfig, cell: RehearsedCell, job: str, seed: int, tool: str | None) -> RehearsedRun:
    where = Path(cell.config.cell.state_dir) / "runs"
    try:
        runs, _ = run_objects(cell.config, steps_of(cell))
    except CellError as exc:
        return _refused(where, exc, seed)
    without: list[str] = []
    for run_id, _truth in runs[:-1]:
        before = load_run(where, run_id)
        if _outcome_of(before) != "complete":
            return _failed(before, seed, NOT_WELL.format(before.job))
        without += _not_accepted(before)
    run_id, truth = runs[-1]
    outcome = _outcome(load_run(where, run_id), truth, seed)
    outcome = replace(outcome, why=[*without, *outcome.why])
    if outcome.good is None and (made := prediction_of(config, job, tool)):
        outcome = replace(outcome, expected=str(made["text"]))
    return outcome


def _played_before(cell: RehearsedCell) -> dict[str, str]:
    runs = list_runs(Path(cell.config.cell.state_dir) / "runs")
    return {run.job: _verdict_of(run) for run in runs if run.job in cell.jobs[:-1]}


def _verdict_of(run: RunFolder) -> str:
    """What its result was judged, else how the run ended."""
    verdict = (run.read_result() or {}).get("verdict") if _outcome_of(run) == "complete" else None
    return str(verdict or _outcome_of(run) or INTERRUPTED)


def steps_of(cell: RehearsedCell) -> list[Step]:
    """The runs that are played, the rehearsed one last."""
    return [
        Step(
            job,
            0,
            0,
            0,
            "",
            moves_board=rehearsal.moves_board,
            bump=BUMP if rehearsal.bumps_tool else None,
            picks=rehearsal.items,
            held=rehearsal.held,
            part_in_hand=rehearsal.rack is not None and rehearsal.rack.handed,
            given_camera=rehearsal.calibrated_camera,
            given_delay=rehearsal.measured_camera and not _camera_measured(rehearsal),
            delays=_delays(rehearsal, cell.config.robot.roles()),
        )
        for job, rehearsal in zip(cell.jobs, cell.rehearsals, strict=True)
    ]


def _camera_measured(rehearsal: Rehearsal) -> bool:
    return rehearsal.camera is not None and rehearsal.camera.pictures.delay is not None


def _delays(rehearsal: Rehearsal, roles: Mapping[str, str]) -> dict[str, KnownDelay]:
    """By device: the delays that the cell has measured, about which those of the twin are drawn."""
    found: dict[str, KnownDelay | None] = {}
    if (camera := rehearsal.camera) is not None:
        found["fixed_camera" if camera.fixed else "flange_camera"] = camera.pictures.delay
    if rehearsal.belt is not None:
        found["belt"] = rehearsal.belt.delay
    return {roles[role]: delay for role, delay in found.items() if delay is not None and role in roles}


def _outcome(run: RunFolder, truth: dict[str, Any], seed: int) -> RehearsedRun:
    end, result = run.read_end() or {}, run.read_result()
    if end.get("outcome") != "complete" or result is None:
        return _failed(run, seed)
    judged: Judged | None = None
    told: list[str] | None = None
    if result["result"] is not None:
        if kind_of(result).truth:
            judged = beside_truth(result, truth, run.path)
        else:
            told = load(kind_of(result).words)(read_result(result))
    report = run.path / "report.html"
    why = [str(reason) for reason in result.get("reasons") or ()]
    warnings = dict.fromkeys(str(one["text"]) for one in result.get("warnings") or ())
    return RehearsedRun(
        seed=seed,
        ended="complete",
        seconds=_seconds(run),
        verdict=str(result["verdict"]),
        stated="" if judged is None else judged.stated,
        off="" if judged is None else judged.off,
        good=None if told is not None else judged is not None and judged.good,
        inside95=None if judged is None else judged.inside95,
        of95={} if judged is None else dict(judged.of95),
        limits95={} if judged is None else dict(judged.limits95),
        told=told or [],
        why=why,
        warnings=[text for text in warnings if text not in why],
        uncovered=[] if judged is None else list(judged.uncovered),
        lost=_lost(run.read_journal()),
        report=str(report) if report.exists() else "",
    )


def _refused(where: Path, exc: CellError, seed: int) -> RehearsedRun:
    """A twin in which a job could not be started: the true reason is what came of the one before it."""
    text = f"{exc} ({exc.code}). {exc.hint}"
    if not (made := list_runs(where, newest=1)):
        return RehearsedRun(seed, NOT_STARTED, 0.0, why=[text])
    before = made[0]
    if _outcome_of(before) != "complete":
        return _failed(before, seed, NOT_WELL.format(before.job))
    why = _not_accepted(before) or [text]
    return RehearsedRun(seed, NOT_STARTED, _seconds(before), why=why, lost=_lost(before.read_journal()))


def _not_accepted(before: RunFolder) -> list[str]:
    """That the result of what comes first is not in effect: one that did not pass waits for a person."""
    result = before.read_result() or {}
    if (verdict := result.get("verdict")) == "pass":
        return []
    told = result.get("reasons") or [one["text"] for one in result.get("warnings") or ()]
    reasons = "; ".join(map(str, told)) or "without a reason"
    return [f"its {before.job} was judged {verdict}: {reasons}, and was not accepted"]


def _outcome_of(run: RunFolder) -> str | None:
    return (run.read_end() or {}).get("outcome")


def _failed(run: RunFolder, seed: int, first: str = "") -> RehearsedRun:
    end = run.read_end() or {}
    failure = end.get("error") or {}
    journal = run.read_journal()
    text = f"{failure.get('text')} ({failure.get('code')}). {failure.get('hint')}" if failure else ""
    if not failure and (prompts := [line["text"] for line in journal if line.get("event") == "prompt"]):
        text = f"this was asked again and again, and doing it did not help: {prompts[-1]}"
    why = [sentence for sentence in (first, text) if sentence]
    outcome = str(end.get("outcome", INTERRUPTED))
    return RehearsedRun(seed, outcome, _seconds(run), why=why, lost=_lost(journal))


def _seconds(run: RunFolder) -> float:
    times = [line["t"] for line in run.read_journal() if isinstance(line.get("t"), int | float)]
    return float(times[-1] - times[0]) if times else 0.0


def _lost(journal: Sequence[dict[str, Any]]) -> list[str]:
    """Poses that were skipped and passes that were not used, each with the reason."""
    events = ("pose skipped", "pass not used")
    return [f"{line['event']}: {line.get('why', '')}" for line in journal if line.get("event") in events]
