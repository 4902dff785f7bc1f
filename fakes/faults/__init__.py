"""The vocabulary of faults, and how each shows on a thing of the world."""
