"""Laser trackers and total stations: GeoCOM, or any program that sends points as lines of text."""

from drivers.tracker.geocom import GeocomTracker
from drivers.tracker.geocom_config import GeocomConfig
from drivers.tracker.line_config import LineStreamConfig
from drivers.tracker.line_points import LinePointConfig, LinePointTracker
from drivers.tracker.line_stream import LineStreamTracker

__all__ = [
    "GeocomConfig",
    "GeocomTracker",
    "LinePointConfig",
    "LinePointTracker",
    "LineStreamConfig",
    "LineStreamTracker",
]
