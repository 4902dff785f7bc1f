"""How far a belt is from what is configured of it, where nobody has calibrated it: standard deviations.

What a job states of such a belt, and what a rehearsal draws, are these. Both are assumptions. The travel of
one count follows from a wheel's circumference, which wears and is given to a few tenths of a per cent, or
from a roller's diameter and the belt's thickness, whose neutral line nobody measures. The direction is that
of a frame put up by tape and eye, some millimetres on a metre.
"""

SCALE_SHARE = 0.005  # of the travel of one count, of itself
TURN_RAD = 0.005  # of the direction, about the belt's normal
