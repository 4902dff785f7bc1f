"""The tool frame from two crossed light beams: point and axis with their uncertainty; see docs/methods.md."""
