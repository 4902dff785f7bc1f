"""What is made of a result for the disk, the ledger, registers and status."""

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from cell.errors import error
from cell.formats.result import NO_FIGURES, Envelope
from daemon import run_end, stored_result
from daemon.stored_result import texts_of
from procedures.in_worker import in_worker

RESULT = Envelope(kind="hand-eye", verdict="pass")


def _figures_fail(*_: Any) -> Any:
    raise ZeroDivisionError("of a kind of another package")


def test_a_result_whose_figures_cannot_be_told_is_a_misfit_and_has_its_text(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stored_result, "read_result", lambda *_: SimpleNamespace(figures=_figures_fail))
    made = texts_of(RESULT, "result.json", None)
    assert '"kind": "hand-eye"' in made.result
    assert made.kept.figures == NO_FIGURES
    assert made.kept.misfit is not None
    assert made.kept.misfit.name == "RESULT_INVALID"


def test_the_end_of_a_run_survives_a_result_that_cannot_be_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_end, "kept_of", _figures_fail)
    run: Any = SimpleNamespace(id=1, result=RESULT, figures=NO_FIGURES, shown=None)
    run_end.keep_shown(run)
    assert run.shown is None


class _Dying:
    async def call(self, fn: Any, *args: Any, **kwargs: Any) -> Any:
        raise error("CHILD_DIED", "the solver process ended")


def test_what_a_dying_solver_left_is_made_here() -> None:
    assert asyncio.run(in_worker(_Dying(), str.upper, "a")) == "A"


class _Refusing:
    async def call(self, fn: Any, *args: Any, **kwargs: Any) -> Any:
        return fn(*args, **kwargs)


def test_an_error_of_the_work_itself_is_not_tried_again() -> None:
    calls: list[int] = []

    def work() -> None:
        calls.append(1)
        raise error("RESULT_INVALID", "as it is")

    with pytest.raises(Exception, match="as it is"):
        asyncio.run(in_worker(_Refusing(), work))
    assert calls == [1]
