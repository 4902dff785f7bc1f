"""Job ``tracker-sampling``: where a laser tracker sees an arm, and the arm's kinematics from that."""
