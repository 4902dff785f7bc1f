import gc
import subprocess
import sys

import pytest

from cell.collector import without_collector


@pytest.fixture(autouse=True)
def _collector_as_it_was() -> None:
    gc.enable()


def test_no_garbage_is_looked_for_meanwhile_and_what_was_made_is_passed_over_for_ever() -> None:
    before = gc.get_freeze_count()
    with without_collector():
        assert not gc.isenabled()
        kept = [[] for _ in range(1000)]
    assert gc.isenabled()
    assert gc.get_freeze_count() >= before + len(kept)


def test_an_import_that_fails_leaves_the_collector_on() -> None:
    with pytest.raises(ModuleNotFoundError), without_collector():
        raise ModuleNotFoundError
    assert gc.isenabled()


def test_the_inner_of_two_leaves_it_to_the_outer() -> None:
    with without_collector():
        with without_collector():
            pass
        assert not gc.isenabled()


@pytest.mark.parametrize("module", ["procedures.registry", "daemon.vision_child"])
def test_the_modules_of_all_jobs_and_of_the_vision_child_are_imported_so(module: str) -> None:
    code = f"import gc, {module}; print(gc.get_freeze_count() > 10_000 and gc.isenabled())"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "True\n"
