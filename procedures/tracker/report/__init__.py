"""The report of a kinematic calibration."""
