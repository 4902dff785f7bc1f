"""Job belt-calibration: the belt's scale and direction."""
