"""What the daemon will start by itself, told before it does: the arm's own program after a check."""

from daemon.config import CellConfig
from daemon.config.program_after import JOB


def program_after_words(config: CellConfig) -> str | None:
    """What the daemon will do by itself, in a sentence; None where it starts no program."""
    section = config.robot.program_after
    if section is None:
        return None
    return (
        f"after each {JOB} that a program of the robot at {section.asked_from} asked for and that passed, the"
        f" daemon loads '{section.program}' on '{config.robot.roles()['arm']}' and starts it: the arm MOVES"
        " by that program, on ways that nobody checks here; after any other run it starts nothing"
    )
