"""A run folder that is removed in mid-run ends the run; nothing is committed without its record."""

import shutil
from pathlib import Path

import pytest

from fakes.object import run_virtual
from tests.kit.hand_eye_made import quick_solver
from tests.kit.object_cell import no_report, open_cell, write_config

__all__ = ["no_report", "quick_solver"]
pytestmark = pytest.mark.usefixtures("no_report", "quick_solver")


def test_a_run_folder_that_is_removed_ends_the_run_by_name(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as subject:
            await subject.start()
            await subject.clock.sleep(2.0)
            assert subject.engine.active
            shutil.rmtree(subject.runs)
            subject.runs.mkdir()
            begun = subject.clock.now()
            await subject.until(lambda: not subject.engine.active, "the end")
            assert subject.clock.now() - begun < 3.0
            assert subject.engine.status()["error"]["name"] == "RUN_FOLDER_LOST"
            assert subject.at_rest()
            assert subject.ledger.results() == []
            assert subject.ledger.runs()[0]["outcome"] == "aborted"
            assert list(subject.runs.iterdir()) == []

    run_virtual(main())


def test_a_result_whose_run_folder_is_moved_away_is_not_proposed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as subject:
            import daemon.engine as engine

            propose = engine.propose_results

            async def after_a_move(run, folder, ledger):  # type: ignore[no-untyped-def]
                folder.path.rename(tmp_path / "elsewhere")
                await propose(run, folder, ledger)

            monkeypatch.setattr(engine, "propose_results", after_a_move)
            await subject.start()
            while subject.engine.active:
                await subject.answer()
                await subject.clock.sleep(0.05)
            assert subject.engine.status()["error"]["name"] == "RUN_FOLDER_LOST"
            assert subject.ledger.results() == []

    run_virtual(main())
