"""One folder for each family of jobs, what a job plugs in (``kind``), and what all jobs share."""
