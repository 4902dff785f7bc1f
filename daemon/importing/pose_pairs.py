"""What all importers end in: pairs of poses as ``cellward.capture/1``."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.errors import CellError, error
from cell.formats.capture import SCHEMA, Capture
from cell.formats.reading import parse
from cell.poses import to_pose6

Setup = Literal["eye-in-hand", "eye-to-hand"]
SETUPS: tuple[Setup, ...] = ("eye-in-hand", "eye-to-hand")
# The target of poses that something else measured: it stands for the size that their errors act over.
_POINTS = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0], [0.0, 0.1, 0.0]]


@dataclass(frozen=True, eq=False)
class PosePair:
    """One place of the arm: ``T_base_flange``, and ``T_camera_target`` as something else measured it."""

    flange: RigidTransform
    target: RigidTransform
    group: int = 0
    q: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Imported:
    """Pairs of poses from one place, and what was left out of them, in sentences."""

    source: Path
    setup: Setup
    pairs: Sequence[PosePair]
    left_out: Sequence[str] = field(default_factory=tuple)

    def capture(self, program: str, read_as: str) -> dict[str, Any]:
        """The document of a data set for 'cellward solve hand-eye'; ``DATA_INVALID`` when it is none.

        ``read_as`` names the units of the program's file; those of the document are m and rad.
        """
        document = {
            "schema": SCHEMA,
            "setup": self.setup,
            "camera": None,
            "target": {"type": "points", "points": _POINTS},
            "observations": [_observation(i, pair) for i, pair in enumerate(self.pairs)],
            "notes": {"imported_from": program, "source": self.source.name, "read_as": read_as},
        }
        parse(Capture, document, SCHEMA, str(self.source))
        return document


def chosen_setup(given: str | None, told: Setup | None, where: Path, hint: str) -> Setup:
    """The setup that the file tells or the person gave; both must agree. ``hint`` says what is missing."""
    if given is not None and given not in SETUPS:
        raise error("ARGUMENT_INVALID", f"--setup {given}: it is {' or '.join(SETUPS)}")
    if given is not None and told is not None and given != told:
        raise error("ARGUMENT_INVALID", f"--setup {given}: {where} says that it is {told}; leave --setup out")
    for setup in SETUPS:
        if setup == (given or told):
            return setup
    raise error(
        "ARGUMENT_INVALID",
        f"{hint}: give --setup eye-in-hand (camera on the flange) or --setup eye-to-hand (camera at rest)",
    )


def fault(path: Path, where: str, what: object) -> CellError:
    """The one sentence of what is wrong in a file of another program."""
    return error("DATA_INVALID", f"{path}: {where}: {what}" if where else f"{path}: {what}")


def _observation(index: int, pair: PosePair) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "index": index,
        "group": pair.group,
        "T_base_flange": _numbers(pair.flange),
        "T_camera_target": _numbers(pair.target),
    }
    if pair.q:
        entry["q"] = list(pair.q)
    return entry


def _numbers(pose: RigidTransform) -> list[float]:
    return [float(v) for v in np.asarray(to_pose6(pose))]
