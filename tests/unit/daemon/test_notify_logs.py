"""One log record is one line, in the form that its reader wants."""

import io
import json
import logging
from collections.abc import Iterator

import pytest

from daemon.logs import Format, set_up_logging


@pytest.fixture(autouse=True)
def _logging_as_it_was() -> Iterator[None]:
    root = logging.getLogger()
    handlers, level = list(root.handlers), root.level
    yield
    root.handlers[:] = handlers
    root.setLevel(level)


def written(style: Format | None, environment: dict[str, str] | None = None) -> list[str]:
    stream = io.StringIO()
    set_up_logging(None, style, stream, environment or {})
    log = logging.getLogger("cellward.test")
    log.debug("not at this level")
    log.info("device %s is\nback", "arm", extra={"outage_s": 1.5})
    try:
        raise ValueError("a defect")
    except ValueError:
        log.exception("run %d", 7)
    return stream.getvalue().splitlines()


def test_the_prefix_form_gives_journald_the_priority_and_stays_on_one_line() -> None:
    info, defect = written("prefix")
    assert info == "<6>cellward.test: device arm is | back outage_s=1.5"
    assert defect.startswith("<3>cellward.test: run 7 | Traceback")
    assert defect.endswith("ValueError: a defect")


def test_the_json_form_carries_fields_and_traceback() -> None:
    info, defect = (json.loads(line) for line in written("json"))
    assert (info["level"], info["logger"], info["outage_s"]) == ("info", "cellward.test", 1.5)
    assert info["text"] == "device arm is\nback"
    assert info["time"].endswith("+00:00")
    assert "ValueError: a defect" in defect["traceback"]


@pytest.mark.parametrize(
    ("environment", "begins"),
    [
        ({"JOURNAL_STREAM": "8:1234"}, "<6>"),
        ({"CELLWARD_LOG_FORMAT": "json"}, "{"),
        ({"CELLWARD_LOG_FORMAT": "nonsense"}, "20"),
        ({}, "20"),
    ],
)
def test_the_form_follows_the_environment(environment: dict[str, str], begins: str) -> None:
    assert written(None, environment)[0].startswith(begins)


def test_the_level_follows_the_environment_and_an_unknown_one_is_info() -> None:
    assert written("plain", {"CELLWARD_LOG_LEVEL": "error"})[0].split()[1] == "error"
    assert len(written("plain", {"CELLWARD_LOG_LEVEL": "loud"})) == 2
    assert "debug" in written("plain", {"CELLWARD_LOG_LEVEL": "debug"})[0]
