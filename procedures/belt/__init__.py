"""Jobs on a moving belt: its calibration, and picking items from it."""
