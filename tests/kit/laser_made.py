"""What tests of the crossed-beam jobs take as given: a reference, and a solver that answers at once."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from cell.formats.result import Envelope
from daemon.config import CellConfig
from procedures.laser.config import LaserReferenceConfig, Search
from procedures.laser.result import SecondScan
from tests.kit.laser_cell import TOOL
from tests.kit.whole_results import made

T_TOOL = [0.0, 0.0, 0.18, 0.0, 0.0, 0.0]


def drawn_reference(config: CellConfig) -> dict[str, Any]:
    """The reference of the straight tool as a run would have made it, without its passes."""
    section = LaserReferenceConfig.model_validate(config.job_section("laser-reference"))
    beam = {"point": [-0.45, 0.45, 0.25], "dir": [1.0, 0.0, 0.0]}
    return {
        "schema": "cellward.laser-reference/1",
        "tool": {"id": TOOL, "p_ref": T_TOOL[:3], "axis_ref": [0.0, 0.0, 1.0], "radius": 0.003},
        "T_flange_tool": T_TOOL,
        "R_base_flange": [3.141592653589793, 0.0, 0.0],
        "beams": {"xs": beam, "ys": {**beam, "dir": [0.0, 1.0, 0.0]}},
        "hits": {"xs": beam["point"], "ys": beam["point"]},
        "passes": [],
        "time_offset_s": 0.0,
        "search": Search.from_config(section, config.poses, "beams").model_dump(),
    }


@dataclass
class Solved:
    """What the solver will answer."""

    dp: list[float] = field(default_factory=lambda: [0.001, -0.0007, 0.0])
    drot: list[float] | None = None
    U: float = 0.0001
    U_second: float = 0.0001
    tau: float = 0.0
    meets: bool = True
    misses: list[float] = field(default_factory=list)  # of the scans with the candidate, as shares of U
    verdict: str = "pass"

    def current(self, *_: Any, **__: Any) -> Any:
        answer = {"dp_flange": self.dp, "drot_flange": self.drot, "tau": self.tau, "hysteresis_m": 0.0001}
        return self.result("laser", {**answer, "cov": [[0.0] * 6] * 6})

    def reference(self, *_: Any) -> Any:
        plane = {"gap_m": 0.0003, "slope_rad": {"xs": 0.001, "ys": -0.001}}
        return self.result("laser-reference", {"tau": self.tau, "plane": plane})

    def second(self, path: Path, *_: Any) -> SecondScan:
        scans = sum((path.parent / name / path.name).exists() for name in ("second", "third"))
        share = self.misses[scans - 1] if self.misses else 0.0 if self.meets else 10.0
        apart = share * self.U
        return SecondScan(
            meets=share <= 1.0,
            scans=scans,
            false_alarm=1.0 / 300.0,
            apart=apart,
            U_m=self.U,
            U_point_m=self.U_second,
            reasons=[],
        )

    def result(self, kind: str, answer: dict[str, Any]) -> Envelope:
        return made(
            {
                "kind": kind,
                "verdict": self.verdict,
                "reasons": [],
                "warnings": [],
                "result": answer,
                "uncertainty": {"U_point_m": self.U},
            }
        )


def answer_at_once(patch: pytest.MonkeyPatch) -> Solved:
    """Put a stand-in where the jobs call the solver; what it answers can be set."""
    solved = Solved()
    patch.setattr("procedures.laser.check.solve_laser", solved.current)
    patch.setattr("procedures.laser.reference.solve_new_reference", solved.reference)
    patch.setattr("procedures.laser.update.compare_second", solved.second)
    return solved


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> Solved:
    """The jobs with a solver that answers at once."""
    return answer_at_once(monkeypatch)
