"""Data sets and results as they are on disk: strict models and readers."""
