"""Hand-eye calibration from a capture data set."""
