"""What is known of grips that took nothing, for whoever has to find out why."""

from procedures.belt.motion.arm_following import ArmFollowing
from procedures.belt.motion.gripper_times import GripperTimes
from procedures.words import mm, ms


def grip_alarm(failed: int, following: ArmFollowing, times: GripperTimes) -> str:
    """One line about the last ``failed`` grips: were the items where the tool was, was the tool where it was
    sent, and has the gripper ever confirmed an item."""
    off = following.contacts.off_m[-failed:]
    where = mm(max(off), 1) if off else "an unknown distance"
    closed = "not confirmed an item yet"
    if times.closing_s is not None:
        closed = f"taken {times.closing_s:.2f} s at most to confirm one"
    return (
        f"{failed} in a row. At these contacts items were at most {where} beside the tool, as later counts "
        f"and pictures show; the tool was {mm(following.lately_m, 1)} beside its set-points and the arm "
        f"{ms(following.lag.s, 0)} late; the gripper has {closed}"
    )
