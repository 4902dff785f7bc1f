"""Listening, serial lines, checksums and deadlines that every device server shares."""
