"""What a result was made from: data, versions, identities, calibrations, payload."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cell.store.files import to_json
from procedures.kinematics_in_use import in_words
from procedures.report.html import Html, absent, bullets, el, section, table
from procedures.report.numbers import DASH, dig, mm, number
from procedures.report.source import Source

POSE = 6  # numbers of one: m, and a rotation vector in rad
_ELSEWHERE = ("sampling", "trend")  # sections of their own show these


def inputs_section(source: Source[Any]) -> Html:
    """Everything a second person needs to come to the same result."""
    inputs = source.result.made_from().model_dump(mode="json")
    rows: list[tuple[object, object]] = []
    run = source.run
    rows += _rows(
        ("run", dig(run, "run_id")),
        ("job", dig(run, "job")),
        ("started", dig(run, "started")),
        ("cell", dig(run, "config", "cell", "name")),
        ("twin", "yes: a simulated cell" if dig(run, "config", "cell", "twin") else None),
        ("software", source.result.software),
        ("versions", _plain(dig(run, "versions"))),
    )
    identities = run.get("identities")
    if isinstance(identities, Mapping):
        rows += [(f"device {name}", _identity(entry)) for name, entry in identities.items()]
    values = run.get("values")
    if moved_arm(source):
        rows += _rows(
            ("payload", None if dig(values, "payload_kg") is None else f"{dig(values, 'payload_kg')} kg"),
            ("tool", _plain(dig(values, "tool"))),
            ("arm", dig(values, "robot", "model")),
        )
    rows += _rows(("calibrations in effect", _versions(values)))
    shown = {"solve_seconds": _seconds, "arm_model": in_words, "steps_taken_again": _taken_again}
    rows += [
        (_label(key, value), shown[key](value) if key in shown else _plain(value, key))
        for key, value in inputs.items()
        if key not in _ELSEWHERE and value is not None
    ]
    rows.append(("schema", source.result.schema_))
    return section("Inputs", table((), [(el("b", a), b) for a, b in rows]))


def moved_arm(source: Source[Any]) -> bool:
    """Whether tool and payload of the run are those of the arm that it is about, and not of one beside it."""
    sampling = getattr(source.result.made_from(), "sampling", None)
    role = sampling.get("role") if isinstance(sampling, Mapping) else getattr(sampling, "role", None)
    return role != "observed_arm"


def figures_section(source: Source[Any]) -> Html:
    """The answer as it stands in the file, for kinds that have no sections of their own."""
    answer = source.result.as_json().get("result")
    if answer is None:
        return section("The result", absent("There is no answer."))
    rows = [(el("b", key), el("code", to_json(value))) for key, value in answer.items()]
    return section("The result", table((), rows))


def _taken_again(entries: Any) -> Html:
    """Each step that a short silence of a device interrupted: nothing measured during one is used."""
    return bullets(f"{e['step']}: {e['why']}; {e['lost_s']:.1f} s lost" for e in entries)


def _rows(*pairs: tuple[str, Any]) -> list[tuple[object, object]]:
    return [(name, value) for name, value in pairs if value not in (None, "", DASH)]


def _label(key: str, value: Any) -> str:
    """A key as words; its unit stands with the value."""
    words = key.removesuffix("_m") if isinstance(value, float) else key
    return "data" if key == "path" else words.replace("_", " ")


def _plain(value: Any, name: str = "") -> object:
    """As a person reads it; a pose, by its name, in mm and degrees as everywhere in a report."""
    if value is None:
        return None
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {_plain(v, str(k))}" for k, v in value.items()) or "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return mm(value) if name.endswith("_m") else f"{value:.7g}"
    if name == "path":  # the folder is the machine's on which it was solved
        return Path(str(value)).name
    if not isinstance(value, list):
        return str(value)
    if not value:
        return "none"
    if name.startswith("T_") and len(value) == POSE and all(number(v) is not None for v in value):
        place = " ".join(f"{1e3 * v:.3f}" for v in value[:3])
        return f"({place} mm, rotation vector {' '.join(f'{math.degrees(v):.4f}' for v in value[3:])} deg)"
    return f"[{', '.join(str(_plain(v)) for v in value)}]"


def _seconds(value: Any) -> str:
    seconds = number(value)
    return DASH if seconds is None else f"{1e3 * seconds:.1f} ms, the solver alone"


def _identity(entry: Any) -> object:
    if not isinstance(entry, Mapping):
        return str(entry)
    return ", ".join(f"{k} {v}" for k, v in entry.items() if isinstance(v, str | int | float))


def _versions(values: Any) -> str | None:
    if values is None:
        return None
    versions = dig(values, "versions")
    if isinstance(versions, Mapping) and versions:
        return ", ".join(f"{name} version {version}" for name, version in versions.items())
    return "none committed; configured values were used"
