"""The palletizer: an arm that its own program moves."""
