"""A job on a twin of the very cell that is configured, before anything real moves."""
