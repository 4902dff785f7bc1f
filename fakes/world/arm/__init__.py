"""The arm and its tool: kinematics, motion and shape as functions of time."""
