"""What every test is held to: nothing leaks, and nothing blocks the event loop."""

import asyncio
import fcntl
import gc
import os
import random
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from tests.kit.left_behind import children, require_gone, sockets, threads

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_name] = "1"  # as in every process of the product, and before numpy reads them

settings.register_profile("cellward", deadline=None)  # a PC that pauses is no finding
settings.load_profile("cellward")

DATA = Path(os.environ.get("CELLWARD_DATA", Path(__file__).parents[2] / "shared" / "data"))


LONGEST_IMPORT_S = 300.0  # of one module of tests, on a computer with much else to do
SPOKEN_OF = ("wire", "alone")  # marks of which a module with such tests has the word
_said: dict[tuple[Path, str], bool] = {}


def _says(path: Path, word: str) -> bool:
    if (path, word) not in _said:
        _said[path, word] = word in path.read_text("utf-8")
    return _said[path, word]


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Where only tests with one of these marks are asked for, spare the import of modules that have none:
    most of them."""
    wanted, _, more = str(config.getoption("markexpr")).partition(" and ")
    if more and wanted in SPOKEN_OF and collection_path.match("test_*.py"):
        return None if _says(collection_path, wanted) else True
    return None


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """One process at a time imports a module of tests.

    All workers import the same modules in the same order. In a new checkout pytest first rewrites the
    assertions of each, which takes longer than all else in it: who waits finds that done.
    """
    if not isinstance(collector, pytest.Module):
        return (yield)
    with collector.path.open("rb") as module:
        if not _locked(module.fileno()):

            def refuse() -> Any:
                raise collector.CollectError(
                    f"another process has had the lock of {collector.path} for {LONGEST_IMPORT_S:g} s; "
                    "'lslocks' names it: end it, for it hangs while it imports this module, and start again"
                )

            collector.collect = refuse  # type: ignore[method-assign]  # told by a worker, too
        return (yield)


def _locked(file: int) -> bool:
    """Take the lock of a module; False when another process does not let go of it."""
    give_up = time.monotonic() + LONGEST_IMPORT_S
    while time.monotonic() < give_up:
        with suppress(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        time.sleep(0.02)
    return False


def pytest_itemcollected(item: pytest.Item) -> None:
    for mark in SPOKEN_OF:
        if item.get_closest_marker(mark) and not _says(item.path, mark):
            raise pytest.UsageError(f"{item.path}: has tests marked {mark}, so it must say the word '{mark}'")


def pytest_collection() -> None:
    gc.disable()


def pytest_collection_finish() -> None:
    """Keep modules and tests, which live as long as the process, out of what the collector looks through.

    It costs every test a seventh of its time otherwise.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
    gc.enable()


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of public data sets with real images, or a skip."""
    if not DATA.is_dir():
        pytest.skip(f"no folder of real data sets at {DATA}; set CELLWARD_DATA")
    return DATA


def _on_loop() -> bool:
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return False
    return True


def _refusing(name: str, call: Callable[..., Any]) -> Callable[..., Any]:
    def guarded(*args: Any, **kwargs: Any) -> Any:
        if _on_loop():
            raise AssertionError(f"{name} blocks the event loop")
        return call(*args, **kwargs)

    return guarded


@pytest.fixture(autouse=True)
def _same_delays_each_time() -> None:
    """Pauses between attempts to reconnect are drawn: on virtual time a test runs the same each time."""
    random.seed(1)


@pytest.fixture(autouse=True)
def _nothing_blocks_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "sleep", _refusing("time.sleep", time.sleep))
    monkeypatch.setattr(os, "fsync", _refusing("os.fsync", os.fsync))


@pytest.fixture(autouse=True)
def _nothing_leaks(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A task, thread, socket or child that outlives its test fails it.

    ``restarts_children`` marks tests on a cell, or with a browser, of their module, whose processes end and
    start again meanwhile: what is left of those is for its fixture to see.
    """
    leaked_tasks: list[str] = []
    cancel_all = asyncio.runners._cancel_all_tasks  # type: ignore[attr-defined]

    def record(loop: asyncio.AbstractEventLoop) -> None:
        leaked_tasks.extend(repr(t) for t in asyncio.all_tasks(loop))
        cancel_all(loop)

    monkeypatch.setattr(asyncio.runners, "_cancel_all_tasks", record)
    seen = {"threads": threads, "children": children, "sockets": sockets}
    before = {what: now() for what, now in seen.items()}
    yield
    assert not leaked_tasks, f"tasks left behind: {leaked_tasks}"
    if request.node.get_closest_marker("restarts_children"):
        del seen["children"]
    for what, now in seen.items():
        require_gone(what, before[what], now)
