"""Where items on a belt will be, from an intercept data set."""
