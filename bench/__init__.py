"""Benchmarks: programs that print a table with a peer side by side, never timed tests."""

import os

# Before numpy is imported, and as the product has it: a second BLAS thread makes small matrices no faster,
# and many times slower where another program has the other core.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
