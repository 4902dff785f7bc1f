"""A fake controller in a process of its own, for tests.

The genuine client's constructor holds the interpreter lock while it waits for the controller, so the two
cannot live in one process.
"""

import asyncio
import multiprocessing
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from cell.errors import CellError, error
from fakes.faults.vocabulary import Switchboard
from fakes.ur.build import build_controller
from fakes.ur.controller import Controller
from fakes.ur.injection import ControllerFaults
from fakes.ur.state import controller_state
from fakes.wire.lifetime import die_with_parent, run_as_controller
from fakes.world.scenario import Scenario

START_TIMEOUT_S = 120.0  # a spawned interpreter imports SciPy, on a machine that may be busy
REPLY_TIMEOUT_S = 5.0


class ControllerHandle:
    """The running child: inject faults, ask for the truth, know its pid."""

    def __init__(self, process: BaseProcess, connection: "Connection[Any, Any]") -> None:
        if process.pid is None:
            raise RuntimeError("the fake controller's process has not been started")
        self._process, self._connection = process, connection
        self.pid = process.pid

    def inject(self, fault: str, **arguments: Any) -> None:
        """Begin ``fault`` (see :mod:`fakes.faults.vocabulary`); ``clear`` ends lasting ones."""
        if fault == "kill":
            self._process.kill()
            return
        self._ask("inject", fault, arguments)

    def truth(self) -> dict[str, Any]:
        """What the controller's world is now, as plain values."""
        state: dict[str, Any] = self._ask("truth")
        return state

    def _ask(self, *request: Any) -> Any:
        self._connection.send(request)
        if not self._connection.poll(REPLY_TIMEOUT_S):
            raise error("CALL_TIMEOUT", f"fake controller {self.pid}: no answer to {request[0]}")
        ok, value = self._connection.recv()
        if not ok:
            raise error(*value)
        return value


@contextmanager
def running_controller(
    bind: str, scenario: str | Path | None = None, **settings: Any
) -> Iterator[ControllerHandle]:
    """A controller on ``bind`` in a child process, ready to be connected to.

    ``settings`` replace fields of its identity (``model``, ``serial``, ``version``).
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])  # SciPy is imported once, not by each controller
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, bind, scenario, settings), daemon=True)
    process.start()
    theirs.close()
    try:
        if not ours.poll(START_TIMEOUT_S):
            raise error(
                "CALL_TIMEOUT", f"fake controller on {bind} did not come up in {START_TIMEOUT_S:.0f} s"
            )
        ok, value = ours.recv()
        if not ok:
            raise error(*value)
        yield ControllerHandle(process, ours)
    finally:
        ours.close()
        process.join(3.0)
        if process.is_alive():
            process.kill()
            process.join()
        process.close()


def _serve(
    connection: "Connection[Any, Any]", bind: str, scenario: str | Path | None, settings: Mapping[str, Any]
) -> None:
    die_with_parent()
    run_as_controller()
    try:
        asyncio.run(_run(connection, bind, scenario, settings))
    except CellError as exc:
        connection.send((False, (exc.name, exc.detail)))
    except OSError as exc:
        connection.send((False, ("DEVICE_UNREACHABLE", f"{bind}: {exc}")))


async def _run(
    connection: "Connection[Any, Any]", bind: str, scenario: str | Path | None, settings: Mapping[str, Any]
) -> None:
    loaded = Scenario.load(scenario) if scenario is not None else None
    controller = build_controller(bind, loaded, settings)
    faults = ControllerFaults(controller)
    switchboard = Switchboard()
    switchboard.devices["arm"] = faults
    await controller.start()
    done = asyncio.Event()
    loop = asyncio.get_running_loop()

    def answer() -> None:
        try:
            request = connection.recv()
        except EOFError:
            done.set()
            return
        connection.send(_reply(controller, switchboard, request))

    loop.add_reader(connection.fileno(), answer)
    connection.send((True, None))
    try:
        await done.wait()
    finally:
        loop.remove_reader(connection.fileno())
        faults.close()
        await controller.stop()


def _reply(controller: Controller, switchboard: Switchboard, request: tuple[Any, ...]) -> tuple[bool, Any]:
    try:
        if request[0] == "inject":
            switchboard.inject("arm", request[1], request[2])
            return True, None
        return True, controller_state(controller)
    except CellError as exc:
        return False, (exc.name, exc.detail)
