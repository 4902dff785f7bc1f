"""A UR controller on the wire: RTDE, dashboard, script port and primary port over one simulated arm."""
