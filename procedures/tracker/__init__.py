"""Job ``tracker-sampling``: where a laser tracker sees an arm, and the arm's kinematics from that."""

from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.procedure import TrackerSampling

__all__ = ["TrackerSampling", "TrackerSamplingConfig"]
