"""One module per job, and the path from a data set to a result."""
