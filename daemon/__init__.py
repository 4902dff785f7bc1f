"""Composition root: configuration, supervision, triggers, control, and the command line."""
