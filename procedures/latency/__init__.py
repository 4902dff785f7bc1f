"""Job ``latency-calibration``: the constant delay of a source's stamps against the arm's."""
