"""What a rehearsal found, for people."""

from collections import Counter
from collections.abc import Iterator, Sequence

from daemon.rehearsal.play import NOT_STARTED, RehearsedRun

MOST_LINES = 5


def outcome_lines(job: str, outcome: RehearsedRun) -> Iterator[str]:
    """One twin: how it ended, how good the result was, and what fell out."""
    verdict = f", verdict {outcome.verdict}" if outcome.verdict else ""
    time = f" after {_time(outcome.seconds)} of the cell"
    if outcome.ended == NOT_STARTED:
        time = f"; what comes first took {_time(outcome.seconds)} of the cell" if outcome.seconds else ""
    yield f"{job}, twin {outcome.seed}: {outcome.ended}{time}{verdict}"
    for name, came_to in outcome.before.items():
        used = came_to == "pass" and outcome.ended != NOT_STARTED
        went_by = ", and this run goes by its result" if used else ""
        yield f"  played before it: {name} ({came_to}){went_by}"
    for sentence in outcome.why:
        yield f"  {sentence}"
    for text in outcome.warnings:
        yield f"  warning: {text}"
    if outcome.stated and not outcome.off:
        yield f"  stated: {outcome.stated}" + (
            "" if outcome.good else ", which the twin's truth does NOT bear out"
        )
    elif outcome.stated:
        words = "agrees with it" if outcome.good else "does NOT agree with it"
        if outcome.good and outcome.inside95 is False:
            words = "is good enough, but beyond the stated 95 %"
        yield f"  stated: {outcome.stated}; off the twin's truth: {outcome.off}, which {words}"
    for line in outcome.expected.splitlines():
        yield f"  expected of the cell: {line}"
    yield from outcome.told
    if outcome.good is None:
        yield "  not compared with the twin's truth: there is no such comparison for this kind of result"
    for text, number in Counter(outcome.lost).most_common(MOST_LINES):
        yield f"  fell out: {text}" + (f" ({number} times)" if number > 1 else "")
    more = len(set(outcome.lost)) - MOST_LINES
    if more > 0:
        yield f"  and {more} more reasons in the journal"
    if outcome.report:
        yield f"  report: {outcome.report}"


def summary_lines(job: str, outcomes: Sequence[RehearsedRun]) -> Iterator[str]:
    """All twins together; nothing where there is one."""
    if len(outcomes) < 2:
        return
    if all(outcome.ended == NOT_STARTED for outcome in outcomes):
        reasons = Counter(outcome.why[0] for outcome in outcomes if outcome.why)
        ((reason, number),) = reasons.most_common(1) or [("no reason is known", len(outcomes))]
        most = "" if number == len(outcomes) else f"in {number} of them because "
        yield f"{job}: could not be started in any of {len(outcomes)} twins: {most}{reason.rstrip('.')}"
        return
    good = sum(outcome.succeeded for outcome in outcomes)
    times = [outcome.seconds for outcome in outcomes if outcome.ended == "complete"]
    span = f", in {_time(min(times))} to {_time(max(times))} of the cell" if times else ""
    judged = [outcome.good for outcome in outcomes if outcome.good is not None]
    agreed = f"; the result agreed with the truth in {sum(judged)}" if len(judged) == len(outcomes) else ""
    yield f"{job}: ended well in {good} of {len(outcomes)} twins{span}{agreed}"


def twin_lines(outcomes: Sequence[RehearsedRun]) -> Iterator[str]:
    """Once for all twins: what the stated limits do not cover, and keys of the cell's devices that its twins,
    which are all made alike, do not have."""
    for what in dict.fromkeys(what for outcome in outcomes for what in outcome.uncovered):
        yield f"not covered by the stated 95 %: {what}"
    if outcomes and (keys := outcomes[0].not_in_twin):
        yield f"not in the twin: {'; '.join(keys)}"


def _time(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
