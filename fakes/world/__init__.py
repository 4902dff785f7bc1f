"""The physical world of the twin: a scenario says what it is, and all of it is a function of time."""
