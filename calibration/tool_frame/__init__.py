"""The tool frame from two crossed light beams: point and axis with their uncertainty, METHODS section 3."""
