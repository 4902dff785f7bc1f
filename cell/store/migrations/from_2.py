"""Schema 2 to 3: a calibration notes the folder of its run, which keeps what is too large for the ledger."""

SQL = """
ALTER TABLE calibrations ADD COLUMN folder TEXT;
UPDATE calibrations SET folder = (SELECT folder FROM runs WHERE runs.run_id = calibrations.run_id);
"""
MISSING = "NULL AS folder"
