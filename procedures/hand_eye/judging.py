"""Whether frames can be used: does the board show, did anything move, is the camera alive."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cell.devices import ArmState, BoardView, Frame, Intrinsics, flange_poses
from cell.samples import Sample
from procedures.hand_eye.config import ConeCaptureConfig


@dataclass(frozen=True)
class BoardSeen:
    """A board in a frame, and the camera that took it."""

    board: BoardView
    intrinsics: Intrinsics


def shows_board(frame: Frame, min_corners: int) -> bool:
    """Whether the frame shows enough of the board."""
    return frame.board is not None and len(frame.board.ids) >= min_corners


def fault_of(
    frames: Sequence[Frame],
    states: Sequence[Sample[ArmState]],
    config: ConeCaptureConfig,
    min_corners: int,
) -> str | None:
    """Why the frames of one pose cannot be used, or None. ``states`` are the arm's meanwhile."""
    seen = [f for f in frames if shows_board(f, min_corners)]
    if 2 * len(seen) <= len(frames):
        return f"the board shows in {len(seen)} of {len(frames)} frames"
    if not states:
        return "no arm state while the frames were taken"
    flange = flange_poses([s.value for s in states]).translation
    motion = float(np.max(np.linalg.norm(flange - flange.mean(axis=0), axis=1)))
    if motion > config.max_flange_motion_m:
        return f"the flange moved {1e3 * motion:.3f} mm while the frames were taken"
    wander = _corner_motion(seen)
    if wander > config.max_corner_motion_px:
        return f"the board moved {wander:.2f} px between the frames"
    return None


def repeats(before: BoardView | None, frames: Sequence[Frame]) -> bool:
    """Whether a frame shows, to the last bit, what was seen before the arm moved: a frozen camera."""
    if before is None:
        return False
    boards = (f.board for f in frames if f.board is not None)
    return any(np.array_equal(board.corners, before.corners) for board in boards)


def moved_since(before: Mapping[str, Any], board: BoardView) -> float:
    """RMS pixels between the board as recorded (``ids``, ``corners``) and now, from the same arm pose."""
    now = dict(zip(board.ids.tolist(), board.corners, strict=True))
    pairs = [(uv, now[i]) for i, uv in zip(before["ids"], before["corners"], strict=True) if i in now]
    if not pairs:
        return float("inf")
    return float(np.sqrt(np.mean([np.sum((np.array(a) - b) ** 2) for a, b in pairs])))


def _corner_motion(frames: Sequence[Frame]) -> float:
    """RMS wander in pixels of the corners common to all frames, against their mean; 0 with one frame."""
    boards = [f.board for f in frames if f.board is not None]
    common = set.intersection(*(set(b.ids.tolist()) for b in boards))
    if len(boards) < 2 or not common:
        return 0.0
    stack = np.stack([b.corners[[b.ids.tolist().index(i) for i in sorted(common)]] for b in boards])
    return float(np.sqrt(np.mean(np.sum((stack - stack.mean(axis=0)) ** 2, axis=2))))
