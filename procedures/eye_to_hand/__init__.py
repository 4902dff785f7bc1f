"""Job `eye-to-hand-check`: a fixed camera judged by a target at a known place on the flange."""
