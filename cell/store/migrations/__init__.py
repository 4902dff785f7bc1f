"""Changes of the ledger's form: one file a step, each from one schema version to the next.

A step is never edited once it has been in a version that somebody runs; a new form is a new step.
"""

from cell.store.migrations import from_1, from_2, from_3

STEPS = {1: from_1.SQL, 2: from_2.SQL, 3: from_3.SQL}
# Columns of the calibrations that a ledger of an older form lacks, for those who may only read it.
MISSING = {1: f"{from_1.MISSING}, {from_2.MISSING}", 2: from_2.MISSING}
