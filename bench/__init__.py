"""Benchmarks: programs that print a table with a peer side by side, never timed tests."""
