"""Laser trackers and total stations: GeoCOM over a serial line or TCP."""
