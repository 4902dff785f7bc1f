"""Two tests of pose accuracy side by side: what a calibration is worth, or what wear has done."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cell.errors import error
from procedures.comparison import Compared
from procedures.iso9283.result import Iso9283Answer, Iso9283Result
from procedures.words import mm, table

_NEAR_M, _SAME_KG = 0.001, 1e-3


@dataclass(frozen=True)
class IsoComparison:
    """``poses`` have, for each pose, the AP and RP of both (m); ``how`` says how each was commanded."""

    poses: list[dict[str, Any]]
    how: tuple[str, str]
    place: tuple[str, str]

    def as_dict(self) -> dict[str, Any]:
        return {"poses": self.poses, "commanded": list(self.how), "registration": list(self.place)}

    def rows(self) -> list[Compared]:
        """AP and RP of each pose; of one that its tracker did not resolve, the upper bound."""
        return [
            Compared(key, "m", second - first, None, first, second, row["pose"])
            for row in self.poses
            for key in ("AP", "RP")
            for first, second in [row[key]]
        ]

    def text(self, first: str, second: str) -> str:
        """AP and RP of both tests; a figure that its tracker did not resolve is an upper bound."""
        head = ("pose", f"AP {first}", f"AP {second}", f"RP {first}", f"RP {second}")
        cells = [
            [row["pose"], *(_shown(row, key, k) for key in ("AP", "RP") for k in (0, 1))]
            for row in self.poses
        ]
        lines = [
            f"{first} was commanded {self.how[0]}, {second} {self.how[1]}; the tracker's place was "
            f"{self.place[0]}, and {self.place[1]}",
            table(head, cells),
        ]
        if self.place[0] != self.place[1]:
            lines.append("A fitted place takes up an error that all poses share: the AP are not of one kind.")
        return "\n".join(lines)


def compare_iso9283(first: Iso9283Result, second: Iso9283Result, _false_alarm: float) -> IsoComparison:
    """Side by side and without a test.

    ``PAYLOAD_DIFFERS`` for other loads; ``ARGUMENT_INVALID`` for other poses, reflector or speed.
    """
    a, b = first.result, second.result
    if abs(a.payload_kg - b.payload_kg) > _SAME_KG:
        raise error(
            "PAYLOAD_DIFFERS",
            f"one test was made with {a.payload_kg:g} kg, the other with {b.payload_kg:g} kg",
        )
    same = (("speed_share", a.speed_share, b.speed_share), ("reflector", a.reflector, b.reflector))
    for key, one, other in same:
        if one != other:
            raise error(
                "ARGUMENT_INVALID",
                f"one test has {key} {one}, the other {other}; only tests alike in it are compared",
            )
    rows = []
    for p, q in zip(a.poses, b.poses, strict=True):
        apart = sum((x - y) ** 2 for x, y in zip(p.commanded, q.commanded, strict=True)) ** 0.5
        if apart > _NEAR_M:
            raise error(
                "ARGUMENT_INVALID", f"pose {p.name} of the tests is {mm(apart)} apart; test the same poses"
            )
        row: dict[str, Any] = {"pose": p.name}
        row |= {"AP": [p.AP, q.AP], "AP_resolved": [p.AP_resolved, q.AP_resolved]}
        row |= {"RP": [p.RP, q.RP], "RP_resolved": [p.RP_resolved, q.RP_resolved]}
        rows.append(row)
    return IsoComparison(rows, (_how(a), _how(b)), (_place(a), _place(b)))


def _how(answer: Iso9283Answer) -> str:
    return "through its calibrated kinematics" if answer.corrected else "by the model of its controller"


def _place(answer: Iso9283Answer) -> str:
    return "fitted" if answer.registration.how == "fit" else "taken from the calibration"


def _shown(row: Mapping[str, Any], key: str, k: int) -> str:
    shown = mm(row[key][k])
    return shown if row[f"{key}_resolved"][k] else f"at most {shown}"
