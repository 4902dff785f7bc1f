"""The report of a test of pose accuracy and repeatability."""
