"""Job ``cone-capture``: hand-eye calibration from camera poses on a cone around a board."""
