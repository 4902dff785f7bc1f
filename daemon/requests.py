"""What people may ask of the engine, over the control socket or the page: checked, carried out, audited.

Both ask through :func:`carry_out`, so there is one table of what can be asked, and one way to start a job.
"""

import json
import logging
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from cell.errors import CellError, error
from cell.store.signatures import Statement
from daemon.auditor import Auditor
from daemon.start_request import StartRequest

log = logging.getLogger("cellward.requests")

MAX_AUDITED_CHARS = 500
MAX_DEPTH = 16
MAX_NUMBER = 2**63 - 1  # as the ledger's columns hold it


class DecisionsControl(Protocol):
    """What is decided of results and calibrations."""

    async def accept(
        self, result_id: int, who: str, warned: bool = False, why: str = ""
    ) -> dict[str, Any]: ...
    async def reject(self, result_id: int, who: str, why: str) -> dict[str, Any]: ...
    async def rollback(self, name: str, who: str) -> dict[str, Any]: ...
    async def sign(self, run_id: int, said: Statement, who: str) -> dict[str, Any]: ...
    async def acknowledge_ledger(self) -> dict[str, Any]: ...


class EngineControl(Protocol):
    """What is asked of the job engine. All refusals are ``CellError``."""

    def status(self) -> dict[str, Any]: ...
    def live(self, since: Mapping[str, int]) -> dict[str, Any]: ...
    def joints(self) -> dict[str, Any]: ...
    async def start(self, request: StartRequest) -> dict[str, Any]: ...
    async def confirm(self, prompt_id: int, who: str) -> None: ...
    async def skip(self, prompt_id: int, who: str) -> None: ...
    async def finish(self, who: str) -> None: ...
    async def abort(self, who: str) -> None: ...
    async def halt(self, who: str) -> None: ...
    async def pause(self, who: str) -> None: ...
    async def resume(self, who: str) -> None: ...
    async def reset(self, who: str) -> None: ...
    @property
    def decisions(self) -> DecisionsControl: ...
    def subscribe(self, listener: Callable[[], None], /) -> Callable[[], None]: ...


@dataclass(frozen=True)
class Caller:
    """Who asks, over which channel (``control`` or ``web``)."""

    who: str
    channel: str


class Params:
    """Checked access to the parameters of one request."""

    def __init__(self, method: str, raw: Mapping[str, Any]) -> None:
        self._method, self._raw = method, raw

    def get(self, name: str, kind: type, default: Any = None) -> Any:
        """The parameter or its default; ``ARGUMENT_INVALID`` when it is missing or of another kind."""
        value = self._raw.get(name)
        if value is None:
            value = default
        if value is None:
            raise error("ARGUMENT_INVALID", f"{self._method} needs '{name}'")
        if type(value) is not kind:
            raise error("ARGUMENT_INVALID", f"{self._method}: '{name}' is not of type {kind.__name__}")
        return value


async def carry_out(
    engine: EngineControl, auditor: Auditor, method: str, params: Mapping[str, Any], caller: Caller
) -> Any:
    """Carry out one write and audit it, done or refused; ``ARGUMENT_INVALID`` for one that there is not."""
    handler = WRITES.get(method)
    if handler is None:
        raise error("ARGUMENT_INVALID", f"there is no method '{method}'")
    what = audited(method, params)
    try:
        result = await handler(engine, Params(method, params), caller)
    except BaseException as exc:  # a write that the daemon's end cuts short is told, too
        auditor.note(caller.who, what, False, str(exc) or type(exc).__name__)
        raise
    auditor.note(caller.who, what, True)
    return result


def live(engine: EngineControl, params: Params) -> dict[str, Any]:
    """What the running job leaves to be drawn, from the rows on that ``since`` names for each trace."""
    since = params.get("since", dict, {})
    if not all(type(number) is int for number in since.values()):
        raise error("ARGUMENT_INVALID", "live: 'since' has a row number for each trace")
    return engine.live(since)


async def _start(engine: EngineControl, params: Params, caller: Caller) -> dict[str, Any]:
    adopt = params.get("adopt", int, 0)
    request = StartRequest(
        params.get("job", str),
        {str(k): str(v) for k, v in params.get("params", dict, {}).items()},
        caller.who,
        caller.channel,
        params.get("dry_run", bool, False),
        adopt or None,
    )
    return await engine.start(request)


WRITES: dict[str, Callable[[EngineControl, Params, Caller], Awaitable[Any]]] = {
    "start": _start,
    "confirm": lambda engine, params, by: engine.confirm(params.get("prompt_id", int), by.who),
    "skip": lambda engine, params, by: engine.skip(params.get("prompt_id", int), by.who),
    "finish": lambda engine, params, by: engine.finish(by.who),
    "abort": lambda engine, params, by: engine.abort(by.who),
    "halt": lambda engine, params, by: engine.halt(by.who),
    "pause": lambda engine, params, by: engine.pause(by.who),
    "resume": lambda engine, params, by: engine.resume(by.who),
    "reset": lambda engine, params, by: engine.reset(by.who),
    "accept": lambda engine, params, by: _brief(
        engine.decisions.accept(
            params.get("result_id", int),
            by.who,
            params.get("warned", bool, False),
            params.get("why", str, ""),
        )
    ),
    "reject": lambda engine, params, by: _brief(
        engine.decisions.reject(params.get("result_id", int), by.who, params.get("why", str, ""))
    ),
    "sign": lambda engine, params, by: engine.decisions.sign(
        params.get("run_id", int),
        Statement(*(params.get(key, str) for key in ("name", "role", "remark", "digest"))),
        by.who,
    ),
    "acknowledge_ledger": lambda engine, params, by: engine.decisions.acknowledge_ledger(),
    "rollback": lambda engine, params, by: _brief(engine.decisions.rollback(params.get("name", str), by.who)),
}


async def _brief(decision: Awaitable[dict[str, Any]]) -> dict[str, Any]:
    """What was decided, without documents: a reference of megabytes would hold up the loop for its reply."""
    entry = await decision
    return {k: v for k, v in entry.items() if k != "result" and not isinstance(v, dict)}


def audited(method: str, params: Mapping[str, Any]) -> str:
    """A write as one bounded line of text."""
    text = f"{method} {json.dumps(params)}" if params else method
    return text if len(text) <= MAX_AUDITED_CHARS else f"{text[:MAX_AUDITED_CHARS]}..."


def check_bounds(value: Any, depth: int = 0) -> None:
    """Refuse what the ledger or an answer could not hold: nesting, numbers and text beyond theirs."""
    if depth > MAX_DEPTH:
        raise too_deep()
    if isinstance(value, dict):
        for key, inner in value.items():
            check_bounds(key, depth + 1)
            check_bounds(inner, depth + 1)
    elif isinstance(value, list):
        for inner in value:
            check_bounds(inner, depth + 1)
    elif isinstance(value, str):
        try:
            value.encode()
        except UnicodeEncodeError as exc:
            raise error("ARGUMENT_INVALID", "the request holds text that is not valid Unicode") from exc
    elif isinstance(value, int | float) and not -MAX_NUMBER <= value <= MAX_NUMBER:
        raise error("ARGUMENT_INVALID", "the request holds a number beyond 2**63 - 1, or not a number")


def too_deep() -> CellError:
    return error("ARGUMENT_INVALID", f"the request is nested deeper than {MAX_DEPTH}")


def described(exc: Exception) -> dict[str, object]:
    """An error as an answer has it; one without a code is a defect, and is logged."""
    if isinstance(exc, CellError):
        return exc.as_dict()
    log.error("a request failed in an unexpected way", exc_info=exc)
    return error("INTERNAL", f"{type(exc).__name__}: {exc}").as_dict()
