"""A recording of the wire, played to the drivers that made it: devices that are a memory."""
