"""A result on its way to the disk, and what the daemon keeps of it: made in the solver's process."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from cell.errors import CellError, error
from cell.formats.result import NO_FIGURES, Envelope, Figures
from cell.store.files import plain, to_json
from cell.store.json_text import JsonText
from cell.store.summary import summary
from procedures.documents import read_result


@dataclass(frozen=True)
class Kept:
    """What is short of a result, and why the result does not fit its kind, if so."""

    figures: Figures
    shown: dict[str, Any]  # by the status
    summary: dict[str, Any]  # as the ledger has it
    misfit: CellError | None


def kept_of(result: Envelope, where: str = "the result") -> Kept:
    """What is kept of ``result``; registers show nothing of one that does not fit its kind."""
    return _kept(plain(result.as_json()), where)


@dataclass(frozen=True)
class Texts:
    """What is written of a result, and what is kept of it."""

    result: JsonText  # of result.json
    value: JsonText  # of the calibration that it proposes, as the ledger stores it
    kept: Kept


def texts_of(result: Envelope, where: str, value: Any) -> Texts:
    """Of ``result``, which goes to ``where``, and of ``value``, which is plain or a model."""
    document = plain(result.as_json())
    dumped = value.model_dump(mode="json", by_alias=True) if isinstance(value, BaseModel) else value
    return Texts(JsonText(to_json(document, indent=1)), JsonText(to_json(dumped)), _kept(document, where))


def summary_of(result: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a result that a status shows: without what is long, as the ledger keeps it."""
    kept = {k: result.get(k) for k in ("kind", "verdict", "reasons", "result", "uncertainty", "residuals")}
    kept["observability"] = {"parameters": (result.get("observability") or {}).get("parameters")}
    kept["update"] = (result.get("inputs") or {}).get("update")
    return summary(kept)


def _kept(document: Mapping[str, Any], where: str) -> Kept:
    try:
        figures, misfit = read_result(document, where).figures(), None
    except CellError as exc:
        figures, misfit = NO_FIGURES, exc
    except Exception as exc:  # of a kind of another package: it must not cost the result
        said = f"{where}: its figures cannot be told: {type(exc).__name__}: {exc}"
        figures, misfit = NO_FIGURES, error("RESULT_INVALID", said)
    return Kept(figures, summary_of(document), summary(document), misfit)
