"""A tracker's points as lines of text on TCP."""
