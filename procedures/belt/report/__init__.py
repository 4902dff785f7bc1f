"""The reports of the belt jobs."""
