"""The contract everybody shares: devices, samples, clocks, errors, motion, journal and results."""
