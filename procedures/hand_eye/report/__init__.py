"""The report of a hand-eye calibration."""
