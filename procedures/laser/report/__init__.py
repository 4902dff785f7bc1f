"""The report of the crossed-beam jobs."""
