"""How tests are collected by several processes at once."""

import fcntl
from pathlib import Path

import pytest

from tests.conftest import pytest_make_collect_report


def test_a_module_of_tests_is_imported_by_one_process_at_a_time(request: pytest.FixtureRequest) -> None:
    module = request.node.getparent(pytest.Module)
    collecting = pytest_make_collect_report(module)
    next(collecting)
    assert _is_taken(module.path)
    report = pytest.CollectReport(module.nodeid, "passed", None, [])
    with pytest.raises(StopIteration) as ended:
        collecting.send(report)
    assert ended.value.value is report
    assert not _is_taken(module.path)


def test_a_module_that_another_run_does_not_let_go_of_is_an_error_that_says_so(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.conftest.LONGEST_IMPORT_S", 0.05)
    module = request.node.getparent(pytest.Module)
    monkeypatch.setattr(module, "collect", module.collect)
    with module.path.open("rb") as elsewhere:
        fcntl.flock(elsewhere, fcntl.LOCK_EX)
        collecting = pytest_make_collect_report(module)
        next(collecting)
        with pytest.raises(module.CollectError, match=r"the lock of \S+test_collection\.py for 0\.05 s"):
            module.collect()
        collecting.close()


def _is_taken(path: Path) -> bool:
    with path.open("rb") as module:
        try:
            fcntl.flock(module, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        return False
