"""The pages of a run of picking and of a belt calibration, drawn from runs on virtual time."""

import copy
import json
import shutil
from pathlib import Path

import pytest

from daemon.words.result_text import result_text
from fakes.object import run_virtual
from procedures.belt.report.source import BeltSource
from procedures.report.write import from_folder, render
from tests.kit.picking_cell import picking_cell, picking_config
from tests.unit.procedures.test_report_page import HOSTILE, Page


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Folders of a finished run of either job."""
    found: dict[str, Path] = {}

    async def drawn(run: object) -> None: ...

    async def scene() -> None:
        config = picking_config(tmp_path_factory.mktemp("belt"), {"picks": 2})
        async with picking_cell(config) as cell:
            for job in ("belt-calibration", "belt-tracking"):
                cell.job = job
                run_id = await cell.start()
                await cell.finished(run_id)
                found[job] = cell.folder(run_id).path

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("daemon.results._write_report", drawn)
        run_virtual(scene())
    return found


@pytest.fixture(autouse=True)
def no_plotly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("procedures.report.write.plotly_script", lambda: "")


def page_of(folder: Path) -> tuple[Page, str]:
    page = Page(render(from_folder(folder)))
    return page, " ".join(" ".join(page.words).split())


def figures_of(page: Page) -> set[str | None]:
    return {attributes.get("id") for tag, attributes in page.elements if tag == "div"}


def test_a_run_of_picking_is_drawn_whole(runs: dict[str, Path]) -> None:
    page, text = page_of(runs["belt-tracking"])
    assert {"outcomes", "timing", "contacts", "speed", "beside", "timeline"} <= figures_of(page)
    assert "cannot be drawn" not in text
    assert "2 items picked" in text
    assert "picks per minute" in text
    assert "100.0 % of those that were tried" in text
    for _, attributes in page.elements:
        assert not {"src", "href", "action", "data", "srcset"} & attributes.keys()


def test_lives_of_items_are_those_of_the_journal(runs: dict[str, Path]) -> None:
    source = from_folder(runs["belt-tracking"])
    assert isinstance(source, BeltSource)
    assert [life.outcome for life in source.lives] == ["picked", "picked"]
    for life in source.lives:
        approach, held = life.took("approach", "contact"), life.took("contact", "gripped")
        assert approach is not None
        assert held is not None
        assert 0.1 < approach < 5.0
        assert 0.05 - 0.02 <= held < 0.3  # the dwell, less one step of the picker
        assert life.end > 0.0


def test_a_calibration_is_drawn_with_its_sightings(runs: dict[str, Path]) -> None:
    page, text = page_of(runs["belt-calibration"])
    assert {"ways", "residuals", "trend"} <= figures_of(page)
    assert "cannot be drawn" not in text
    result = json.loads((runs["belt-calibration"] / "result.json").read_text("utf-8"))
    assert f"{1e6 * result['result']['m_per_count']:.3f} µm" in text
    assert "a camera that is turned by more than camera_turn_95_rad" in text


@pytest.mark.parametrize("job", ["belt-calibration", "belt-tracking"])
def test_a_damaged_run_is_told_and_its_text_escaped(runs: dict[str, Path], job: str, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(runs[job], folder)
    result = json.loads((folder / "result.json").read_text("utf-8"))
    damaged = copy.deepcopy(result)
    damaged["reasons"] = [HOSTILE]
    damaged["verdict"] = "fail"
    (folder / "result.json").write_text(json.dumps(damaged))
    for name in ("counts.framed", "steps.framed"):
        if (folder / name).exists():
            (folder / name).write_bytes(b"junk")
    journal = (folder / "journal.jsonl").read_text("utf-8")
    (folder / "journal.jsonl").write_text(journal.replace('"picked"', json.dumps(HOSTILE)))
    page = render(from_folder(folder))
    assert "<img src=x" not in page
    assert "<script>alert" not in page
    if job == "belt-tracking":
        assert "does not begin with" in page


def test_a_refused_calibration_says_what_to_do(runs: dict[str, Path], tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(runs["belt-calibration"], folder)
    result = json.loads((folder / "result.json").read_text("utf-8"))
    result |= {"result": None, "verdict": "fail", "reasons": ["belt-stands: the encoder did not count"]}
    (folder / "result.json").write_text(json.dumps({**result, "residuals": {}}))
    _, text = page_of(folder)
    assert "Start the belt" in text


def test_the_command_line_says_what_was_found(runs: dict[str, Path]) -> None:
    results = {job: json.loads((folder / "result.json").read_text("utf-8")) for job, folder in runs.items()}
    calibrated = result_text(results["belt-calibration"])
    found = results["belt-calibration"]["result"]
    assert f"one count moves the belt by {1e6 * found['m_per_count']:.3f} um (95 %:" in calibrated
    assert "not seen: a camera that is turned by more than" in calibrated
    picked = result_text(results["belt-tracking"])
    assert "2 picked of" in picked
    assert "gripped moving with the item, method ml" in picked
