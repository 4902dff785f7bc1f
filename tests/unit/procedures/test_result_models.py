"""Results as the models of their kinds: stored ones are read and written unchanged, damaged ones are told."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from cell.errors import CellError
from cell.formats.result import Inputs, Part
from cell.store.ledger import Ledger
from daemon.docs.results import results_page
from procedures.documents import read_result
from procedures.kind import KINDS, load
from tests.kit.cli_harness import CellOnDisk, CommandLine
from tests.kit.whole_results import STORED, stored


def unknown(part: object, where: str = "") -> Iterator[str]:
    """Keys of a result, by their path, that its model does not have."""
    if isinstance(part, Part):
        if type(part) is Inputs:  # of data without an answer, whatever their kind
            return
        yield from (f"{where}.{name}" for name in part.model_extra or ())
        for name in type(part).model_fields:
            yield from unknown(getattr(part, name), f"{where}.{name}")
    elif isinstance(part, dict):
        for name, value in part.items():
            yield from unknown(value, f"{where}.{name}")
    elif isinstance(part, list):
        for value in part:
            yield from unknown(value, f"{where}[]")


@pytest.mark.parametrize("path", STORED, ids=lambda p: p.stem)
def test_a_stored_result_is_read_and_written_unchanged(path: Path) -> None:
    subject = read_result(stored(path))
    assert subject.as_json() == stored(path)
    assert list(unknown(subject)) == []


def solved_examples(folder: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """What the solvers say of the complete examples in the manual."""
    manual = (Path(__file__).parents[3] / "docs" / "data-sets.md").read_text("utf-8")
    solvers = {"capture": "hand-eye", "laser": "laser", "kincal": "kincal"}
    for number, block in enumerate(re.findall(r"```json\n(.*?)```", manual, re.S)):
        example = json.loads(block)
        kind = solvers.get(example["schema"].removeprefix("cellward.").removesuffix("/1"))
        complete = example.get("target", {}).get("type") == "points" if kind == "hand-eye" else True
        if kind is not None and complete:
            (folder / str(number)).mkdir()
            path = folder / str(number) / KINDS[kind].data_file
            path.write_text(block)
            yield kind, load(KINDS[kind].solve)(path).as_json()
            if kind == "laser":
                yield kind, load(KINDS[kind].solve)(path, method="classic").as_json()


def test_what_the_solvers_say_of_the_manuals_examples_has_no_key_beyond_the_models(tmp_path: Path) -> None:
    found = list(solved_examples(tmp_path))
    assert [kind for kind, _ in found] == ["hand-eye", "laser", "laser", "kincal"]
    for kind, document in found:
        subject = read_result(document)
        assert subject.as_json() == document, kind
        assert list(unknown(subject)) == [], kind
        assert type(subject) is load(KINDS[kind].result)


def test_there_is_a_stored_result_with_an_answer_of_every_kind() -> None:
    kept = {document["kind"] for document in map(stored, STORED) if document["result"] is not None}
    assert kept == {name for name, kind in KINDS.items() if load(kind.result).__name__ != "Result"}


def test_a_key_of_a_later_version_is_kept() -> None:
    document = stored(STORED[0]) | {"later": {"key": [1, None]}}
    assert read_result(document).as_json() == document


def test_every_field_of_every_kind_is_described_in_the_manual() -> None:
    undescribed = [
        line for line in results_page().splitlines() if line.startswith("|") and line.endswith("|  |")
    ]
    assert undescribed == []


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda d: d["result"].pop("AP_max"), "result.AP_max is missing"),
        (
            lambda d: d["result"].update(RP_max="0.1 mm"),
            "result.RP_max does not fit: Input should be a valid number",
        ),
        (lambda d: d["result"]["poses"][0].pop("AP"), "result.poses[0].AP is missing"),
        (lambda d: d.update(verdict="good"), "verdict does not fit"),
        (lambda d: d.update(result=[1, 2]), "result does not fit"),
    ],
)
def test_a_result_that_does_not_fit_its_kind_is_told_by_the_field(change: Any, told: str) -> None:
    document = stored(next(p for p in STORED if p.stem.startswith("iso9283")))
    change(document)
    with pytest.raises(CellError) as raised:
        read_result(document, "run 7")
    assert raised.value.name == "RESULT_INVALID"
    assert raised.value.detail.startswith(f"run 7: {told}")


def test_a_damaged_result_breaks_no_list_and_is_told_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = CellOnDisk(tmp_path)
    subject = CommandLine(monkeypatch, capsys, cell.config)
    damaged = stored(next(p for p in STORED if p.stem.startswith("iso9283")))
    del damaged["result"]["AP_max"]
    cell.add_run(1, damaged, outcome="complete", verdict="pass")
    ledger = Ledger(cell.state / "ledger.sqlite")
    ledger.propose("T_flange_camera", [0.0] * 6, damaged, 1, None)
    ledger.close()
    assert [subject(*words).code for words in (("runs",), ("results",), ("results", "1", "--json"))] == [
        0,
        0,
        0,
    ]
    shown = subject("show", 1)
    assert shown.code == 2
    assert "run 1" in shown.out
    assert "result.json: result.AP_max is missing" in shown.err
    assert "4008" in shown.err
    assert "Traceback" not in shown.err
