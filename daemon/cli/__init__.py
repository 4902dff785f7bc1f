"""The command ``cellward``: what people type. Results go to stdout, messages to stderr.

Exit codes: 0 ok; 1 finished with verdict fail, or a job that did not complete; 2 bad input or usage; 3 device
or daemon unreachable; 4 refused; 5 internal error. A person never sees a traceback.
"""

import os
import sys


def main() -> int:
    """Run one command line; returns the exit code."""
    # Before numpy is imported: with one BLAS thread the same data give the same bits (replay).
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"
    os.environ["PYTHONSAFEPATH"] = "1"  # children, the solver's too: no module from the folder we start in
    from daemon.cli.app import app
    from daemon.cli.failures import reported

    with reported() as failure:
        try:
            app(prog_name="cellward")
        except SystemExit as leaving:
            if isinstance(leaving.__context__, BrokenPipeError):  # else it would look like verdict fail
                raise leaving.__context__ from None
            sys.stdout.flush()  # here, where a reader that went away can still be handled
            return leaving.code if isinstance(leaving.code, int) else int(leaving.code is not None)
    return failure.exit_code
