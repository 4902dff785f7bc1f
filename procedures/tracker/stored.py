"""Poses measured earlier that are solved together with a run's own, so that fewer have to be measured.

That holds only for the same arm, reflectors and load, seen by a tracker that has not been moved since: its
readings are in the tracker's own frame. The monuments that both have seen vouch for that.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cell.errors import CellError, error
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.monuments import compare, moved_text
from procedures.tracker.solve.data import read_kincal

SAME_LOAD_KG = 1e-3
_LEAST_SEEN = 2  # of three or more, as the arm may hide one; poses that do not fit each other show the rest


@dataclass(frozen=True)
class StoredSet:
    """``samples`` as in ``cellward.kincal/1``; ``monuments`` as each was first seen in their run, ``serials``
    of the arm and the tracker that were there."""

    path: Path
    samples: list[dict[str, Any]]
    monuments: dict[str, Any]
    serials: dict[str, str]

    def entries(self) -> list[tuple[list[float], str]]:
        """Joints and reflector of each pose, for a plan."""
        return [(s["q"], s["target"]) for s in self.samples]

    def require_same_devices(self, serials: Mapping[str, str]) -> None:
        """``TRACKER_SET_REFUSED`` when it was measured with another arm or tracker than those of ``serials``.

        An unknown serial says nothing.
        """
        for role, now in serials.items():
            then = self.serials.get(role)
            if then and now and then != now:
                raise self.refused(f"it was measured with {role} {then}, and this is {role} {now}")

    def require_same_stand(self, seen: Mapping[str, Any], limit_m: float) -> None:
        """``TRACKER_MOVED`` when the monuments ``seen`` now are not where the set has them."""
        moved = compare(self.monuments, seen)
        if len(moved) < _LEAST_SEEN:
            names = ", ".join(self.monuments) or "none"
            raise self.refused(
                f"{len(moved)} of its monuments ({names}) were seen now, {_LEAST_SEEN} are needed to tell "
                "that the tracker still stands where it stood"
            )
        if (text := moved_text(moved, limit_m)) is not None:
            raise error("TRACKER_MOVED", f"{text} of {self.path}, so its poses cannot be used with today's")

    def refused(self, why: str) -> CellError:
        """``TRACKER_SET_REFUSED`` for this set."""
        return error("TRACKER_SET_REFUSED", f"{self.path}: {why}")


def load_stored(
    with_set: str, config: TrackerSamplingConfig, robot: Mapping[str, Any], payload_kg: float
) -> StoredSet:
    """The set that ``with_set`` names; reads the disk.

    ``TRACKER_SET_REFUSED`` when it is of another arm, other reflectors or another load than ``robot`` and
    ``payload_kg``; an ``InputError`` when it is no data set.
    """
    path, data = read_kincal(Path(with_set))
    samples = [
        {**s.model_dump(include={"q", "p_tracker", "target"}), "notes": "stored"}
        for s in data.samples
        if s.p_tracker is not None and None not in s.p_tracker
    ]
    facts = (data.notes or {}).get("sampling") or {}
    stored = StoredSet(path, samples, facts.get("monument_points") or {}, facts.get("serials") or {})
    if not _alike(data.robot or {}, robot):
        raise stored.refused("its robot, or a reflector on it, is not this cell's")
    if data.payload_kg is None or abs(data.payload_kg - payload_kg) > SAME_LOAD_KG:
        raise stored.refused(f"its payload_kg is {data.payload_kg}, and here it is {payload_kg:g}")
    if strange := sorted({str(s["target"]) for s in samples} - set(config.reflectors)):
        raise stored.refused(f"target '{strange[0]}' is no reflector of the job")
    return stored


def _alike(a: Mapping[str, Any], b: Mapping[str, Any]) -> bool:
    """Whether two ROBOTs are one; a calibration, which the controller tells, counts where both have it."""
    keys = set(a) | set(b)
    if not ("calibration" in a and "calibration" in b):
        keys.discard("calibration")
    return all(a.get(key) == b.get(key) for key in keys)
