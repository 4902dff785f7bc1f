"""The tool's displacement, or a reference, from passes across two beams."""
