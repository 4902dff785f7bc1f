"""A CAN bus on the event loop, shared by who listens: socketcan, serial adapters and socketcand."""
