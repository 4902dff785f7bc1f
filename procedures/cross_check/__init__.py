"""Cross check: views of a target and the tool in beams, and which part of the cell has changed."""
