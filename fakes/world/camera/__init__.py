"""The camera of the world and the target that it looks at."""
