"""AXB = C: the camera, the target and the arm from a data set, and what was given of them judged."""
