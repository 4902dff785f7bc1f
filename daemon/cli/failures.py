"""How a failed command ends: one clear sentence, what to do next, and the right exit code."""

import os
import signal
import sys
import tempfile
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from cell.errors import CellError, Reaction, error
from daemon.cli.output import say

OK, FAILED, BAD_INPUT, UNREACHABLE, REFUSED, INTERNAL = range(6)
INTERRUPTED = 128 + signal.SIGINT

_BY_REACTION = {
    Reaction.INPUT: BAD_INPUT,
    Reaction.RETRY: UNREACHABLE,
    Reaction.REFUSE: REFUSED,
    Reaction.INTERNAL: INTERNAL,
}


@dataclass
class Failure:
    """Filled in by :func:`reported` when the block fails."""

    exit_code: int = OK


def exit_code_of(failure: CellError) -> int:
    """An error that ends jobs counts as unreachable when it is about a device, else as a failed job."""
    about_device = failure.code < 3000
    return _BY_REACTION.get(failure.reaction, UNREACHABLE if about_device else FAILED)


@contextmanager
def reported() -> Iterator[Failure]:
    """Turn whatever the block raises into a message on stderr and an exit code."""
    failure = Failure()
    try:
        yield failure
    except CellError as exc:
        failure.exit_code = exit_code_of(exc)
        tell(exc)
    except KeyboardInterrupt:
        failure.exit_code = INTERRUPTED
        say("Interrupted.")
    except BrokenPipeError:
        # The reader of our output (head, less) went away; nothing is wrong, and nothing more can be said.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except Exception as exc:
        if isinstance(exc, PermissionError) and exc.filename is not None:
            refusal = error("ACCESS_DENIED", f"{exc.filename}: {exc.strerror}")
            failure.exit_code = exit_code_of(refusal)
            tell(refusal)
            return
        failure.exit_code = INTERNAL
        say(f"Error 9001: {type(exc).__name__}: {exc} (details in {log_details()})")
        say(error("INTERNAL").hint)


def tell(failure: CellError) -> None:
    """The error and its hint, each on its own line; all findings when there are several."""
    findings = getattr(failure, "findings", None)
    if findings:
        say(f"Error {failure.code}: {str(failure).partition(':')[0]}:")
        for finding in findings:
            say(f"  {finding}")
    else:
        say(f"Error {failure.code}: {failure}")
    say(failure.hint)


def log_details() -> str:
    """Write the traceback where a person can find it; returns where that is.

    A service's /tmp (PrivateTmp) is removed when the service ends, so its traceback goes into the log.
    """
    if "INVOCATION_ID" in os.environ and not sys.stderr.isatty():
        traceback.print_exc(file=sys.stderr)
        return "the log, above"
    handle, name = tempfile.mkstemp(prefix="cellward-error-", suffix=".log")
    with os.fdopen(handle, "w") as file:
        traceback.print_exc(file=file)
    return name
