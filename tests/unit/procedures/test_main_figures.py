"""The main figure of a result: every job has one, and it is written as precise as it is known."""

import pytest

from cell.formats.main_figure import MainFigure, read_main_figure
from procedures.documents import read_result
from procedures.kind import KINDS
from tests.kit.whole_results import STORED, stored


@pytest.mark.parametrize("kind", [name for name, kind in KINDS.items() if kind.jobs])
def test_every_result_of_a_job_has_its_main_figure(kind: str) -> None:
    documents = [d for d in map(stored, STORED) if d["kind"] == kind and d["result"] is not None]
    figures = [read_result(document).main_figure() for document in documents]
    assert any(figure is not None for figure in figures)
    for figure in figures:
        assert figure is None or read_main_figure(vars(figure)) == figure


@pytest.mark.parametrize(
    ("figure", "text"),
    [
        (MainFigure("a", "", 3.14159e-4, "m"), "0.314 mm"),
        (MainFigure("a", "", 1.5e-3, "m", 4.2e-5), "1.500 ± 0.042 mm"),
        (MainFigure("a", "", 1.000123e-4, "m", 2.5e-9), "0.1000123 ± 0.0000025 mm"),
        (MainFigure("a", "", 0.0012, "s", 0.0003), "1.20 ± 0.30 ms"),
        (MainFigure("a", "", 0.0012, "s", 0.0), "1.200 ± 0.000 ms"),
        (MainFigure("a", "", 12, ""), "12"),
    ],
)
def test_it_is_as_precise_as_it_is_known(figure: MainFigure, text: str) -> None:
    assert figure.text() == text


@pytest.mark.parametrize(
    "stored",
    [None, 3, {}, {"name": "a", "words": "b", "unit": "m", "value": "x"}, {"value": 1.0, "unit": "m"}],
)
def test_what_is_no_figure_is_read_as_none(stored: object) -> None:
    assert read_main_figure(stored) is None
