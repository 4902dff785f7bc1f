"""A recording of the wire: every byte that a device sends or is sent, with time-stamp and direction."""
