"""Job touch-test: the tool's point over corners of a board that the camera has located."""
