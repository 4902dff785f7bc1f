"""The twin as a program: its devices, its control socket and its command line."""
