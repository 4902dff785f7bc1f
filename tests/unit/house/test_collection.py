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


def _is_taken(path: Path) -> bool:
    with path.open("rb") as module:
        try:
            fcntl.flock(module, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        return False
