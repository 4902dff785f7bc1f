"""Kinematic calibration from a laser tracker's points."""
