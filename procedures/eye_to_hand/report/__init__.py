"""The report of an eye-to-hand check."""
