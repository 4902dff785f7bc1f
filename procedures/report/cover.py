"""The first page of a report, the one that is signed: cell, run, instruments, figures, limits, verdict."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from cell.errors import CellError
from cell.store.fingerprint import fingerprint_as_last_seen
from procedures.kinematics_in_use import in_words
from procedures.report.html import Html, bullets, el, join, note, table
from procedures.report.numbers import DASH, dig, number
from procedures.report.origin import moved_arm
from procedures.report.source import ALTERED_TEXT, Source

ROLES = ("measured", "checked", "approved")
TWIN = "Simulated cell (twin): nothing in this report was measured on real devices."

# How the run was, by what somebody asked for
STOPS = {"abort": "ended", "halt": "stopped at once", "shutdown": "ended with the service"}


@dataclass(frozen=True)
class CoverFigure:
    """One figure of the answer, each part as text with its unit; an empty part is not stated.

    ``within``: whether it keeps to its limit; None where nothing judges it.
    """

    name: str
    value: str
    uncertainty: str = ""
    planned: str = ""
    limit: str = ""
    within: bool | None = None


@dataclass(frozen=True)
class Cover:
    """What a kind of result says on the first page; ``uncovered``: what its uncertainty does not cover."""

    figures: Sequence[CoverFigure] = ()
    uncovered: Sequence[str] = ()


def cover(source: Source[Any], said: Cover) -> Html:
    """The whole page; ``said`` is what the kind of result adds."""
    return el(
        "section",
        twin_banner(source),
        _go(source),
        el("div", _table(_run_rows(source)), _table(_origin_rows(source)), class_="twocolumn"),
        _figures(said.figures),
        _uncovered(said.uncovered) if said.uncovered else None,
        _instruments(source.run),
        sign_off(source),
        class_="cover",
    )


def is_twin(source: Source[Any]) -> bool:
    """Whether the run was one of a simulated cell."""
    return bool(dig(source.run, "config", "cell", "twin"))


def judged(name: str, value: Any, limit: Any, shown: Callable[[Any], str], **more: str) -> CoverFigure:
    """A figure held against the largest that is allowed; nothing judges it where one of them is unknown."""
    plain, most = number(value), number(limit)
    within = None if plain is None or most is None else plain <= most
    return CoverFigure(name, shown(plain), limit="" if most is None else shown(most), within=within, **more)


def twin_banner(source: Source[Any]) -> Html | None:
    """Says in words, and on paper across every page, that the cell was simulated; nothing for a real one."""
    if not is_twin(source):
        return None
    return join([el("p", TWIN, class_="twin"), el("div", "TWIN", class_="watermark", aria_hidden="true")])


def _go(source: Source[Any]) -> Html:
    """GO or NO-GO with the reason; a run that did not complete is no GO whatever its verdict."""
    result, outcome = source.result, dig(source.end, "outcome")
    first = next(iter(result.reasons), "")
    if source.altered:
        word, why, kind = "NO-GO", ALTERED_TEXT, "fail"
    elif outcome not in (None, "complete"):
        word, why, kind = "NO-GO", _ended_by(source), "fail"
    elif getattr(result, "result", None) is None:
        word, why, kind = "NO-GO", f"the data cannot determine the answer. {first}", "fail"
    elif result.verdict == "fail":
        word, why, kind = "NO-GO", first, "fail"
    elif result.verdict == "warn":
        told = next((warning.text for warning in result.warnings), first)
        more = len(result.warnings) - 1
        word, kind = "GO with warnings", "warn"
        why = told + (f" (and {more} more, on the next page)" if more > 0 else "")
    else:
        word, why, kind = "GO", "no limit is exceeded and nothing is to be warned of.", "pass"
    return el("div", el("b", word), el("span", why), class_=f"go {kind}")


def _ended_by(source: Source[Any]) -> str:
    text = dig(source.end, "error", "text") or stopped_by(source)
    return f"the run ended {dig(source.end, 'outcome')}" + (f": {text}" if text else ".")


def stopped_by(source: Source[Any]) -> str:
    """Who ended the run, in a sentence; empty where nobody did."""
    for entry in source.journal:
        if entry.get("kind") == "operator" and entry.get("event") in STOPS:
            by = "" if entry["event"] == "shutdown" else f" by {entry.get('who')}"
            return f"{STOPS[str(entry['event'])]}{by}."
    return ""


Rows = Iterable[tuple[str, object]]


def _run_rows(source: Source[Any]) -> Rows:
    run = source.run
    if not run:
        return [("from", "a data set, without a run")]
    by = run.get("started_by") or next((e for e in source.journal if e.get("event") == "start"), {})
    return [
        ("cell", dig(run, "config", "cell", "name")),
        ("job", run.get("job")),
        ("run", run.get("run_id")),
        ("started", moment(run.get("started"))),
        ("ended", moment(source.end.get("ended")) if source.end else "not yet when this was drawn"),
        ("started by", " over ".join(str(v) for v in (dig(by, "who"), dig(by, "channel")) if v)),
    ]


def _decided(source: Source[Any]) -> str:
    """What became of it, by the ledger when that is known, else by the journal of the run."""
    told = []
    for row in source.decided:
        became = {"proposed": "waits for a decision", "committed": f"in effect as version {row['version']}"}
        words = f"{row['id']} ({row['name']}): {became.get(row['state'], row['state'])}"
        if row.get("who"):
            words += f", decided by {row['who']} on {moment(row.get('decided'))}"
        told.append(words + (f" ({row['why']})" if row.get("why") else ""))
    proposed = [e for e in source.journal if e.get("event") == "proposed"]
    if not told and proposed:
        told = [f"{e.get('result_id')} ({e.get('name')})" for e in proposed]
    return "; ".join(told)


def _origin_rows(source: Source[Any]) -> Rows:
    run = source.run
    versions, values = run.get("versions"), run.get("values")
    model = source.result.made_from().arm_model
    in_effect = dig(values, "versions") or {}
    own = moved_arm(source)
    payload = dig(values, "payload_kg") if own else None
    return [
        ("result", _decided(source)),
        ("software", _versions(versions) if versions else source.result.software),
        ("configuration", _short(run.get("config_digest"))),
        ("tool", dig(values, "tool", "name") if own else None),
        ("payload", None if payload is None else f"{payload:g} kg"),
        ("arm's model", None if model is None else in_words(model.model_dump())),
        ("calibrations", ", ".join(f"{name} version {n}" for name, n in in_effect.items()) or None),
    ]


def _versions(versions: Any) -> str:
    found = dict(versions) if isinstance(versions, Mapping) else {}
    own = found.pop("cellward", "unknown")
    rest = ", ".join(f"{name.split('-')[0]} {version}" for name, version in found.items())
    return f"cellward {own} ({rest})"


def _table(rows: Rows) -> Html:
    shown = [(el("b", name), value) for name, value in rows if value not in (None, "", DASH)]
    return table((), shown)


def _figures(figures: Sequence[CoverFigure]) -> Html | None:
    """Planned beside reached, with uncertainty and limit; columns that nothing fills are left out."""
    if not figures:
        return None
    columns = (
        ("", [f.name for f in figures], "l"),
        ("planned", [f.planned for f in figures], "r"),
        ("reached", [f.value for f in figures], "r"),
        ("uncertainty, 95 %", [f.uncertainty for f in figures], "r"),
        ("limit", [f.limit for f in figures], "r"),
        ("", [{True: "within", False: "beyond", None: ""}[f.within] for f in figures], "l"),
    )
    kept = [column for column in columns if any(column[1])]
    rows = zip(*(cells for _, cells, _ in kept), strict=True)
    return table([head for head, _, _ in kept], rows, "".join(align for _, _, align in kept))


def _uncovered(uncovered: Sequence[str]) -> Html:
    return join([el("h3", "What the uncertainty does not cover"), bullets(uncovered)])


def _instruments(run: Mapping[str, Any]) -> Html | None:
    devices = run.get("identities")
    if not isinstance(devices, Mapping) or not devices:
        return None
    rows = []
    for name, entry in devices.items():
        day = dig(run, "config", "device", str(name), "calibrated")
        rows.append((name, dig(entry, "model"), dig(entry, "serial"), day or "not stated"))
    return join([el("h3", "Instruments"), table(("device", "model", "serial number", "calibrated on"), rows)])


def sign_off(source: Source[Any]) -> Html:
    """Who signed, as the record has it, and lines for those who have not."""
    rows: list[tuple[object, ...]] = []
    done = set[str]()
    for checked in source.signatures:
        if (s := checked.signature) is not None:
            name = s.name + (f" ({s.remark})" if s.remark else "")
            rows.append((s.role, name, moment(s.at), signed_content(checked.changed, s.digest)))
            done.add(s.role)
    rows += [(role, "", "", "") for role in ROLES if role not in done]
    head = ("signed as", "name", "signed on", "signature, or what was signed")
    return el(
        "div",
        el("h3", "Signatures"),
        table(head, rows),
        note(*_digest(source)),
        class_="signatures",
    )


def signed_content(changed: Sequence[str], digest: str) -> Html:
    """Which content a signature is for, and what of it was changed since."""
    content = f"content SHA-256 {digest[:16]}…"
    if not changed:
        return join([content])
    return join([content, el("b", f" changed after signing: {'; '.join(changed)}", class_="fail")])


def _digest(source: Source[Any]) -> tuple[object, ...]:
    if source.folder is None or not source.end:
        return ("The record had not ended when this was drawn: 'cellward report' draws it with its digest.",)
    try:
        digest = fingerprint_as_last_seen(source.folder).digest
    except CellError as exc:
        return (f"The record has no digest: {exc}",)
    return (
        "Digest of the record (SHA-256): ",
        el("code", digest),
        f". 'cellward verify {source.run.get('run_id')}' says whether the record is still the one signed.",
    )


def _short(digest: Any) -> str | None:
    return f"SHA-256 {digest[:16]}…" if isinstance(digest, str) else None


def moment(stamp: Any) -> str:
    """An ISO stamp, or seconds since 1970, in UTC to the second: a report is read anywhere."""
    try:
        if isinstance(stamp, int | float):
            at = datetime.fromtimestamp(stamp, UTC)
        else:
            at = datetime.fromisoformat(stamp)
    except (TypeError, ValueError, OverflowError):
        return DASH
    return f"{at.astimezone(UTC):%Y-%m-%d %H:%M:%S} UTC"
