"""What a run of picking leaves on disk: rows that say what happened, and a data set that can be solved."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import CellError
from cell.formats.capture import Camera
from cell.store.framed import read_framed
from daemon.cli.replay import differences
from fakes.object import run_virtual
from procedures.belt.record import (
    COUNT,
    COUNTS_FILE,
    DATA_FILE,
    SIGHTINGS_FILE,
    STEP,
    STEPS_FILE,
    read_rows,
)
from tests.kit.object_cell import no_report
from tests.kit.picking_cell import (
    POSE_M,
    POSE_RAD,
    TELLS_WRONG,
    contact_errors,
    picking_cell,
    picking_config,
)
from tests.kit.solved import solve_again, solve_intercept

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")


def test_a_run_can_be_solved_again_from_what_it_left(tmp_path: Path) -> None:
    kept: dict[str, Any] = {}

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 2}, TELLS_WRONG)) as cell:
            run_id = await cell.start()
            assert (await cell.finished(run_id))["outcome"] == "complete"
            off = np.linalg.norm(contact_errors(cell), axis=1)
            assert np.all(off < 1e-3), "items are placed with the lens of the camera's calibration"
            kept["lens"] = cell.plant.world.intrinsics, cell.plant.world.told_intrinsics
            kept["folder"] = cell.folder(run_id).path
            kept["again"] = cell.folder(run_id), cell.result(run_id)
            kept["items"] = cell.notes(run_id, "item")
            belt = cell.plant.world.belt
            assert belt is not None
            kept["travel"] = belt.travel_at

    run_virtual(scene())
    folder = kept["folder"]

    counts = read_rows(folder / COUNTS_FILE, COUNT)
    assert len(counts) > 200
    assert np.all(np.diff(counts["t"]) > 0)
    true = np.array([kept["travel"](t) for t in counts["t"]])
    moved = 1e-4 * (counts["count"] - counts["count"][0])
    assert np.abs(moved - (true - true[0])).max() < 2e-4

    steps = read_rows(folder / STEPS_FILE, STEP)
    assert np.abs(np.diff(steps["p"], axis=0)).max() < 0.1, "the way of the tool has no jumps"
    assert {0, 1} <= set(steps["item"])
    assert float(np.median(steps["belt_m_s"])) == pytest.approx(0.15, rel=0.02)

    seen = [json.loads(frame) for frame in read_framed(folder / SIGHTINGS_FILE)[0]]
    assert all(s["recv"] > s["t"] for s in seen)

    data = json.loads((folder / DATA_FILE).read_text("utf-8"))
    assert len(data["encoder"]) == len(counts)
    lens, told = kept["lens"]
    kept_lens, kept_told = (Camera.model_validate(data["camera"][key]) for key in ("lens", "told"))
    assert (kept_lens.intrinsics(), kept_told.intrinsics()) == (lens, told)
    result = solve_intercept(folder)
    assert result["verdict"] != "fail", result["reasons"]
    answers = {a["id"]: a for a in reversed(result["result"]["answers"])}
    for line in kept["items"]:
        contact = next(t for t, what in line["history"] if what == "contact")
        query = next(q for q in data["queries"] if q["id"] == line["item"])
        assert query["t"] + query["horizons"][-1] >= contact - 1e-6
        at = int(np.argmin([abs(query["t"] + h - contact) for h in query["horizons"]]))
        told = np.array(answers[line["item"]]["pred"][at])
        step = steps[int(np.argmin(np.abs(steps["t"] - contact)))]
        assert np.linalg.norm(told - step["p"][:2]) < 5e-3, "the tool went where the item was predicted"

    run, recorded = kept["again"]
    assert recorded["result"]["camera_95_m"] == result["uncertainty"]["camera_95_m"]
    sigma = float(np.hypot(POSE_M, 0.78 * POSE_RAD))  # an item below the camera, as high as most
    assert 1.96 * sigma < recorded["result"]["camera_95_m"] < 1.3 * 1.96 * sigma
    assert recorded["heldout"]["later_sightings"]["count"] > 0
    assert differences(recorded, solve_again(run.job, run.path, run.info, recorded)) == []
    data["encoder"] = [[t, round(1.01 * n)] for t, n in data["encoder"]]
    (folder / DATA_FILE).write_text(json.dumps(data), "utf-8")
    assert differences(recorded, solve_again(run.job, run.path, run.info, recorded))


def test_an_aborted_run_keeps_what_it_saw(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path)) as cell:
            run_id = await cell.start()
            await cell.until_state("descend")
            await cell.engine.abort("test")
            await cell.finished(run_id)
            folder = cell.folder(run_id).path
            assert (folder / DATA_FILE).exists()
            assert len(read_rows(folder / STEPS_FILE, STEP)) > 10

    run_virtual(scene())


def test_a_disk_that_fills_up_ends_the_run_by_name_at_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from cell.errors import error
    from cell.store.framed import FramedWriter

    full: list[CellError] = []
    flush = FramedWriter.flush

    def fail(self: FramedWriter) -> None:
        if full:
            raise full[0]
        flush(self)

    monkeypatch.setattr(FramedWriter, "flush", fail)

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path)) as cell:
            run_id = await cell.start()
            await cell.until_state("approach")
            full.append(error("DISK_FULL", "steps.framed"))
            end = await cell.finished(run_id)
            assert (end["outcome"], end["error"]["name"]) == ("aborted", "DISK_FULL")
            assert cell.at_rest()

    run_virtual(scene())
