"""Files of a run that are not what its job wrote: a sentence that names the folder, not a defect of ours."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cell.errors import error
from daemon.cli.failures import log_details


@contextmanager
def reading(folder: Path) -> Iterator[None]:
    """``FILE_UNREADABLE`` when the block stumbles over what is inside of the files in ``folder``.

    Results, journals and parameters of a run are plain tables without a model of their own, which differ from
    job to job. The traceback is kept, because the fault may be ours all the same.
    """
    try:
        yield
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as exc:
        raise error(
            "FILE_UNREADABLE",
            f"{folder} does not hold what its job writes ({type(exc).__name__}: {exc}; details in "
            f"{log_details()}); restore the folder from a copy",
        ) from exc
