"""Laser trackers and total stations: GeoCOM over a serial line or TCP."""

from drivers.tracker.geocom import GeocomTracker
from drivers.tracker.geocom_config import GeocomConfig

__all__ = ["GeocomConfig", "GeocomTracker"]
