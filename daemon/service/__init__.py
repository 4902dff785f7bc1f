"""The host of a cell: program, user, unit, networks and rules put in place, and taken away again."""
