"""The opening of a slot: found by its edges in colour, and how far a part will be beside its middle."""
