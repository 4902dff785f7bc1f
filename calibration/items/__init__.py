"""Items on a belt, found in colour and depth."""

from calibration.items.detector import ItemDetector, ItemSpec

__all__ = ["ItemDetector", "ItemSpec"]
