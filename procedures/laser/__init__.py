"""Jobs of the crossed light beams: where the tool's point is, measured by crossing two beams with it."""
