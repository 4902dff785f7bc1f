"""Hand-eye calibration: weighted maximum likelihood, its uncertainty, and what the data cannot tell."""
