"""Job `corrected-targets`: an arm that its own program moves, asked for targets as given and corrected."""
