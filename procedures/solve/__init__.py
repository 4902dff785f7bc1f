"""From a data set on disk to a result: what jobs, the replay and the command line call."""
