"""The demo: a twin, the daemon, a PLC that triggers the job, and the result beside the truth."""
