"""The latency calibration on the object face: the delay of the beams as the world has it."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calibration.latency.crossings import SeenCrossing, solve_delay
from cell.calibrations import laser_reference, time_offset
from cell.errors import InputError
from cell.motion import MotionLease
from cell.poses import from_pose6
from cell.procedure import Run
from daemon.cli.replay import differences
from daemon.demo.ending import beside_truth
from fakes.object import run_virtual
from fakes.world.scenario import Scenario
from procedures.arm_setup import lease_settings
from procedures.laser.config import LaserReferenceConfig, Search
from procedures.latency.config import Acceptance, LatencyCalibrationConfig
from procedures.latency.procedure import LatencyCalibration
from procedures.latency.solver import SIGNALS, crossings_of
from procedures.latency.states import State
from procedures.latency.to_and_fro import to_and_fro
from tests.kit.object_cell import WHO, ObjectCell, no_report, on_disk, open_cell, refused, write_config
from tests.kit.solved import solve_again, solve_latency

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

JOB = "latency-calibration"
TOOL = "pin"
QUICK = {"speeds_m_s": [0.02, 0.08], "passes": 6, "accept": {"auto": True}}


def made_by_hand() -> dict[str, Any]:
    """The reference that a perfect measurement of the scenario's world would have given."""
    scenario = Scenario.load("laser:ideal")
    config = LaserReferenceConfig.model_validate(scenario.cell.job["laser-reference"])
    search = Search.from_config(config, scenario.cell.poses, "beams")
    point = from_pose6(scenario.world.tool.T_flange_tool).translation
    down = np.array([np.pi, 0.0, 0.0])
    beams = {name: {"point": beam.point, "dir": beam.dir} for name, beam in scenario.world.beams.items()}
    at = {name: np.add(beam.point, [0.0, 0.0, point[2]]) for name, beam in scenario.world.beams.items()}
    return {
        "schema": "cellward.laser-reference/1",
        "tool": {"id": TOOL, "p_ref": point.tolist(), "axis_ref": [0.0, 0.0, 1.0], "radius": 0.003},
        "R_base_flange": down.tolist(),
        "beams": beams,
        "hits": {name: hit.tolist() for name, hit in at.items()},
        "passes": [],
        "search": search.model_dump(),
        "tau_s": 0.0,
        "time_offset_s": 0.0,
        "cov": None,
    }


def with_reference(cell: ObjectCell) -> None:
    """Committed as if a job had found it."""
    result = {"verdict": "pass", "result": {}}
    on_disk(
        cell.ledger.accept, cell.ledger.propose(laser_reference(TOOL), made_by_hand(), result, 0, None), WHO
    )


def cell_config(folder: Path, **job: Any) -> Any:
    return write_config(folder, "laser:ideal", jobs={JOB: {**QUICK, **job}})


def test_the_delay_is_found_within_its_interval_and_takes_effect(tmp_path: Path) -> None:
    config = cell_config(tmp_path)

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            with_reference(cell)
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "pass"), end["error"]
            truth = cell.plant.world.config.beams["xs"]
            answer = cell.result(1)["result"]
            low, high = answer["interval95_s"]
            assert 0.0 < high - low < 0.002
            assert abs(answer["time_offset_s"] - truth.latency_s) < high - low
            assert abs(answer["hysteresis_m"] - truth.hysteresis_m) < 3e-4
            told = cell.plant.world.truth(cell.clock.now())
            assert beside_truth(cell.result(1), told, cell.folder(1).path).good
            told["beams"]["xs"]["latency_s"] += 1.5 * (high - low)
            assert not beside_truth(cell.result(1), told, cell.folder(1).path).good
            assert cell.ledger.effective(time_offset("beams"), 0.0).value == answer["time_offset_s"]
            assert cell.at_rest()
            again = await cell.run_job()
            # What is in effect is not subtracted twice.
            assert abs(cell.result(2)["result"]["time_offset_s"] - answer["time_offset_s"]) < high - low
            assert again["verdict"] == "pass"

    run_virtual(main())


def test_without_a_reference_the_job_is_refused(tmp_path: Path) -> None:
    config = cell_config(tmp_path)

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            assert (await refused(cell.start())).name == "LASER_NO_REFERENCE"

    run_virtual(main())


def test_a_speed_beyond_the_limits_is_refused_and_not_slowed_down(tmp_path: Path) -> None:
    config = cell_config(tmp_path, speeds_m_s=[0.02, 0.5])

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            with_reference(cell)
            refusal = await refused(cell.start())
            assert refusal.name == "MOTION_LIMIT"
            assert "speeds_m_s has 0.5 m/s" in str(refusal)

    run_virtual(main())


def test_the_limit_is_that_of_the_source_unless_it_is_given() -> None:
    belt = {"source": "belt", "belt_z_m": 0.1}
    given = {"accept": {"max_interval_s": 0.001}}
    tables = [{}, {"accept": {}}, belt, given, belt | given]
    limits = [LatencyCalibrationConfig.model_validate(table) for table in tables]
    assert [config.accept.max_interval_s for config in limits] == [0.006, 0.006, 0.002, 0.001, 0.001]
    assert LatencyCalibrationConfig(accept=Acceptance()) == limits[0]
    assert LatencyCalibrationConfig() == limits[0]
    again = limits[0].model_dump(mode="json")
    assert LatencyCalibrationConfig.model_validate(again) == limits[0]


def test_a_wide_interval_is_a_fail_that_names_the_limit(tmp_path: Path) -> None:
    config = cell_config(tmp_path, accept={"auto": True, "max_interval_s": 1e-5})

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            with_reference(cell)
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "fail")
            (reason,) = cell.result(1)["reasons"]
            assert reason.startswith("max_interval_s")
            assert reason.endswith("0.50 ms of it are the time of an answer, which more passes do not narrow")
            assert cell.ledger.effective(time_offset("beams"), 0.0).version is None

    run_virtual(main())


def test_an_edge_lies_between_the_middles_of_two_polls_that_looked_somewhere_in_their_answers() -> None:
    t = np.arange(0.0, 1.0, 0.002)
    poll_t = np.arange(0.0, 1.0, 0.005)
    entry = {
        "dir": 1,
        "pose_t": t,
        "pose_xyz": np.outer(t, [0.05, 0.0, 0.0]),
        "poll_t": poll_t,
        "poll_v": (poll_t > 0.4).astype(int),
        "poll_dt": np.where(poll_t > 0.4, 0.002, 0.001),
    }
    (subject,) = crossings_of(7, entry, [1.0, 0.0, 0.0])
    assert (subject.way, subject.place, subject.direction) == (7, 0, 1)
    found = subject.speed, subject.x, subject.dt, subject.look
    assert found == pytest.approx((0.05, 0.05 * 0.4025, 0.0025, 0.0015), abs=1e-9)


def test_a_finish_on_the_way_uses_what_was_taken_and_lifts_the_tool(tmp_path: Path) -> None:
    config = cell_config(tmp_path)

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            with_reference(cell)
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.status()["step"] == 4, "four passes", 120.0)
            await cell.engine.finish(WHO)
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete"
            assert cell.result(run_id)["residuals"]["edges"] < 2 * 2 * 12
            assert cell.plant.world.inputs is not None
            assert not any(cell.plant.world.inputs.levels(cell.clock.now()))
            assert cell.at_rest()

    run_virtual(main())


LATE_S = 0.0073


class Positions:
    """Another kind of source: it tells where the tool is at its own rate, late by ``LATE_S``.

    Its places are levels of its own reading, as those of a tracker, a camera or an encoder would be.
    """

    role = "beams"
    signal = "levels"
    device = "beams"

    def __init__(self, config: LatencyCalibrationConfig, run: Run) -> None:
        self.config, self.run = config, run
        self.passes: list[dict[str, Any]] = []
        self.begin = run.arm().state.latest(0.1).value.T_base_flange

    @staticmethod
    def uses() -> tuple[str, ...]:
        return ("arm", "beams")

    @staticmethod
    def refuse(config: LatencyCalibrationConfig, values: Mapping[str, Any]) -> None: ...

    def data(self) -> dict[str, Any]:
        return {"levels": [0.01, 0.02, 0.03], "passes": self.passes}

    def amount(self) -> str:
        return f"{len(self.passes)} ways"

    async def take(self) -> None:
        await to_and_fro(self, self.config, self.run)

    async def plan(self) -> dict[str, Any]:
        return {"sweeps": [], "problems": []}

    async def check(self) -> None: ...

    async def approach(self, lease: MotionLease) -> None: ...

    async def excite(self, lease: MotionLease, speed_m_s: float, number: int) -> None:
        fast = lease_settings(self.run.values)[2]
        end = RigidTransform.from_components(
            self.begin.translation + np.array([0.04, 0.0, 0.0]), self.begin.rotation
        )
        for direction, to, state in ((1, end, State.SWEEP), (-1, self.begin, State.RETURN)):
            await self.run.enter(state)
            began = self.run.clock.now()
            await lease.move_linear(to, replace(fast, tcp_m_s=speed_m_s))
            seen = self.run.arm().state.between(began, self.run.clock.now())
            t = np.array([s.t for s in seen])
            x = np.array([s.value.T_base_flange.translation[0] for s in seen]) - self.begin.translation[0]
            at = np.arange(t[0], t[-1], 0.013)
            reading = {"seen_t": (at + LATE_S).tolist(), "seen": np.interp(at, t, x).tolist()}
            self.passes.append({"dir": direction, "t": t.tolist(), "x": x.tolist(), **reading})

    async def leave(self, lease: MotionLease) -> None:
        await lease.move_linear(self.begin)


def levels(data: Mapping[str, Any]) -> list[SeenCrossing]:
    """Where the arm was when the source's reading passed each level."""
    found = []
    for number, entry in enumerate(data["passes"]):
        seen_t, seen, way = np.array(entry["seen_t"]), np.array(entry["seen"]), entry["dir"]
        for place, level in enumerate(data["levels"]):
            i = int(np.argmax(way * (seen - level) >= 0.0))
            t = float(np.interp(0.0, way * (seen[i - 1 : i + 1] - level), seen_t[i - 1 : i + 1]))
            at = np.interp([t - 0.02, t, t + 0.02], entry["t"], entry["x"])
            speed = float(abs(at[2] - at[0]) / 0.04)
            dt = 0.5 * float(seen_t[i] - seen_t[i - 1])
            found.append(SeenCrossing(number, place, way, speed, float(at[1]), dt))
    return found


def test_another_source_plugs_in_as_a_class_and_a_signal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(LatencyCalibration.SOURCES, "beams", Positions)
    monkeypatch.setitem(SIGNALS, "levels", lambda data: solve_delay(levels(data)))
    config = cell_config(tmp_path, speeds_m_s=[0.02, 0.06], passes=2, accept={"max_interval_s": 0.02})

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "pass"), end["error"]
            answer = cell.result(1)["result"]
            assert answer["time_offset_s"] == pytest.approx(LATE_S, abs=0.0005)
            assert cell.at_rest()
            (row,) = cell.ledger.results(time_offset("beams"))
            assert (row["state"], row["value"]) == ("proposed", answer["time_offset_s"])
            folder = cell.folder(1)
            again = solve_again(folder.job, folder.path, folder.info, cell.result(1))
            assert differences(cell.result(1), again) == []

    run_virtual(main())


def test_a_signal_that_nobody_knows_is_refused_by_name(tmp_path: Path) -> None:
    file = tmp_path / "latency.json"
    file.write_text('{"schema": "cellward.latency/1", "source": "s", "signal": "smoke", "passes": []}')
    with pytest.raises(InputError, match="signal is 'smoke'; it must be one of beam-edges"):
        solve_latency(file)


def test_the_plan_is_shown_without_moving(tmp_path: Path) -> None:
    config = cell_config(tmp_path)

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            with_reference(cell)
            before = cell.plant.world.track.at(cell.clock.now())[0]
            shown = await cell.dry_run()
            names = [row["index"] for row in shown["plan"]["sweeps"]]
            assert [name.split(" mm")[0] for name in names] == ["xs approach", "xs 1 at 14.0", "xs 1 lift"]
            assert [row["sweeps"] for row in shown["plan"]["sweeps"]] == [0, 12, 0]
            assert shown["plan"]["problems"] == []
            assert np.array_equal(cell.plant.world.track.at(cell.clock.now())[0], before)

    run_virtual(main())
