"""The odds of tests that two measurements are of the same thing."""

FALSE_ALARM = 1.0 / 300.0  # how often, at most, what has not changed may be judged to have
FOUND = 0.99  # how often a change by the size that is promised is found
