"""The test of accuracy and repeatability in a cell on virtual time, held against where the arm truly went."""

import asyncio
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.identification.registration import register
from cell.calibrations import kinematics
from cell.devices import Speed
from cell.errors import CellError
from cell.poses import from_pose6
from cell.store.files import read_json, to_json
from cell.store.ledger import Ledger
from daemon.cli.replay import differences
from daemon.config import CellConfig
from daemon.predictions import setup_of
from daemon.values import robot_spec
from fakes.object import run_virtual
from fakes.world.scenario import Scenario
from procedures.iso9283.config import Iso9283Config
from procedures.iso9283.expectation import iso9283_expectation
from procedures.iso9283.plan import ORDER
from procedures.iso9283.session import speed_of
from tests.kit.ideal_world import ideal_text
from tests.kit.object_cell import ObjectCell, no_report, on_disk, open_cell, refused, write_config
from tests.kit.solved import solve_again, solve_iso9283
from tests.kit.tracker_cell import BRISK, nominal_tracker

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

JOB, SCENARIO = "iso9283", "tracker:ideal"
CENTRE, EDGE = np.array([-0.6, -0.5, 0.7]), 0.3
TRUTH = Scenario.load(SCENARIO).world
POINT = np.array(TRUTH.reflectors["smr1"].point)


def towards_the_tracker() -> list[float]:
    """An attitude in which the flange looks at the tracker, a little flattened."""
    assert TRUTH.tracker is not None
    z = (np.array(TRUTH.tracker.T_base_tracker[:3]) - CENTRE) * [1.0, 1.0, 0.3]
    z /= np.linalg.norm(z)
    x = np.cross([0.0, 0.0, 1.0], z)
    x /= np.linalg.norm(x)
    R = Rotation.from_matrix(np.column_stack([x, np.cross(z, x), z]))
    return [float(v) for v in R.as_rotvec()]


def iso_config(
    folder: Path, job: Mapping[str, Any] | None = None, scenario: str = SCENARIO, **more: Any
) -> CellConfig:
    """The tracker's cell with a short test in a small cube; ``more`` is for ``write_config``."""
    section: dict[str, Any] = {
        "reflector": "smr1",
        "point": POINT.tolist(),
        "cube": {"centre": CENTRE.tolist(), "edge_m": EDGE, "R_base_flange": towards_the_tracker()},
        "cycles": 3,
        "settle_s": 0.1,
        "window_s": 0.2,
        "find_timeout_s": 2.0,
        "reacquire_wait_s": 0.2,
        "T_base_tracker_nominal": nominal_tracker(SCENARIO),
        **(job or {}),
    }
    section = {key: value for key, value in section.items() if value is not None}
    return write_config(folder, scenario, jobs={JOB: section}, limits=BRISK, **more)


def true_kinematics(shift_m: float = 0.0) -> dict[str, Any]:
    """What a perfect calibration would have found; ``shift_m`` off in the tracker's place."""
    assert TRUTH.tracker is not None
    deltas = TRUTH.arm.error.model_dump()
    robot = {
        "model": TRUTH.arm.model,
        "calibration": {
            key: list(deltas[key]) for key in ("delta_theta", "delta_d", "delta_a", "delta_alpha")
        },
        "tool": {"smr1": POINT.tolist()},
    }
    T = list(TRUTH.tracker.T_base_tracker)
    return {"robot": robot, "T_base_tracker": [T[0] + shift_m, *T[1:]]}


def commit(cell: ObjectCell, value: Mapping[str, Any]) -> None:
    on_disk(cell.ledger.accept, cell.ledger.propose(kinematics("arm"), dict(value), {}, 0, None), "test")


def true_reflector(cell: ObjectCell, q: Any) -> Any:
    """(3,): by the twin's own kinematics, in the base."""
    return cell.plant.world.true.forward(np.asarray(q)).apply(POINT)


@dataclass
class Done:
    """A finished run, with the data it left."""

    cell: ObjectCell
    end: dict[str, Any]
    result: dict[str, Any]
    data: dict[str, Any]

    @property
    def folder(self) -> Path:
        return self.cell.folder(1).path

    def truth(self) -> tuple[Any, Any]:
        """(9, 3) of all poses: where the reflector was wanted, and where it truly went."""
        wanted = [from_pose6(p["T_base_flange"]).apply(POINT) for p in self.data["poses"]]
        return np.array(wanted), np.array([true_reflector(self.cell, p["q"]) for p in self.data["poses"]])


def run_of(config: CellConfig, value: Mapping[str, Any] | None = None, act: Any = None) -> Done:
    async def main() -> Done:
        async with open_cell(config, job=JOB) as cell:
            if value is not None:
                commit(cell, value)
            if act is not None:
                act(cell)
            end = await cell.run_job()
            assert cell.at_rest()
            result = cell.folder(1).read_result() or {}
            path = cell.folder(1).path / "iso9283.json"
            return Done(cell, end, result, read_json(path) if path.exists() else {})

    return run_virtual(main())


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Done]:
    """The arm as it is, commanded through what its controller believes."""
    patch = pytest.MonkeyPatch()

    async def drawn(run: Any) -> None: ...

    patch.setattr("daemon.results._write_report", drawn)
    yield run_of(iso_config(tmp_path_factory.mktemp("plain")))
    patch.undo()


def test_AP_is_what_the_twin_knows_of_the_true_arm(plain: Done) -> None:
    assert plain.end["outcome"] == "complete"
    wanted, went = plain.truth()
    place = register(wanted.T, went.T, np.ones(len(went)))  # the fit takes a common error of all poses
    true = np.linalg.norm(place.to_tracker(went.T).T - wanted, axis=1)
    for pose, off in zip(plain.data["poses"], true, strict=True):
        if pose["name"] in ORDER:
            found = next(p for p in plain.result["result"]["poses"] if p["name"] == pose["name"])
            assert found["AP_measured"] == pytest.approx(off, abs=found["AP_tracker"])
    assert true[4:].max() > 3e-4, "the arm's errors must show"
    assert plain.result["result"]["AP_max"] == pytest.approx(true[4:].max(), abs=8e-5)


def test_every_pose_is_reached_from_the_same_one_in_every_cycle(plain: Done) -> None:
    visits = [(s["pose"], s["cycle"]) for s in plain.data["samples"]]
    assert visits[:4] == [(f"R{k}", 0) for k in range(1, 5)]
    assert visits[4:] == [(name, cycle) for cycle in (1, 2, 3) for name in ORDER]


def test_the_result_tells_formula_tracker_payload_and_what_is_open(plain: Done) -> None:
    answer = plain.result["result"]
    assert answer["formula"]["AP"].startswith("AP = |mean(p) - p_commanded|")
    assert answer["tracker"]["sigma_axis_m"] == pytest.approx(29e-6, abs=3e-6)
    assert answer["payload_kg"] == 0.8
    assert answer["cycles"] == 3
    assert not answer["corrected"]
    assert "3 cycles were measured; the standard has 30" in plain.result["reasons"]
    undetermined = " ".join(plain.result["observability"]["undetermined"])
    assert "attitude" in undetermined
    assert "common shift" in undetermined


def test_a_replay_gives_the_same_answer(plain: Done) -> None:
    again = solve_again(JOB, plain.folder, read_json(plain.folder / "run.json"), plain.result)
    assert differences(plain.result, again) == []


def test_every_arrival_is_on_disk_at_once(plain: Done) -> None:
    lines = (plain.folder / "samples.jsonl").read_text("utf-8").splitlines()
    assert len(lines) == len(plain.data["samples"]) == 19


def test_worst_figures_are_kept_as_trends(plain: Done) -> None:
    trend = plain.result["inputs"]["trend"]
    assert trend["iso9283.AP_m.uncorrected.arm"][0][1] == plain.result["result"]["AP_max"]


def test_calibrated_kinematics_bring_AP_from_millimetres_to_the_trackers_own(tmp_path: Path) -> None:
    absolute = {"registration": "kinematics", "max_AP_m": 0.0003}
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    before = run_of(iso_config(tmp_path / "a", absolute), true_kinematics())
    after = run_of(iso_config(tmp_path / "b", {**absolute, "corrected": True}), true_kinematics())
    wanted, went = before.truth()
    off = np.linalg.norm(went - wanted, axis=1)[4:]
    for pose, true in zip(before.result["result"]["poses"], off, strict=True):
        assert pose["AP_measured"] == pytest.approx(true, abs=pose["AP_tracker"])
    assert off.max() > 0.001
    assert before.end["verdict"] == "fail"
    assert before.result["reasons"][0].startswith("max_AP_m: AP is P1")
    assert after.end["verdict"] != "fail"
    assert all(p["AP_measured"] < 5e-5 for p in after.result["result"]["poses"])
    assert all(p["AP"] >= p["AP_tracker"] for p in after.result["result"]["poses"])
    assert after.result["result"]["kinematics_version"] == 1
    wanted, went = after.truth()
    assert np.linalg.norm(went - wanted, axis=1).max() < 1e-6


def test_RP_is_that_of_an_arm_that_repeats_badly(tmp_path: Path) -> None:
    shipped = ideal_text("tracker")
    assert "repeatability_t_m = 0.0000139" in shipped
    loose = tmp_path / "loose.toml"
    loose.write_text(shipped.replace("repeatability_t_m = 0.0000139", "repeatability_t_m = 0.0002"), "utf-8")
    config = iso_config(tmp_path, {"cycles": 8}, scenario=str(loose))
    found = run_of(config).result["result"]
    # 0.2 mm along each axis: RP = 3.616 sigma, a little less of eight arrivals.
    middle = float(np.median([p["RP"] for p in found["poses"]]))
    assert middle == pytest.approx(3.616 * 0.0002 * 0.91, rel=0.35)
    assert all(p["RP_resolved"] for p in found["poses"])


def test_a_stand_that_moved_since_the_calibration_is_told(tmp_path: Path) -> None:
    job = {"registration": "kinematics", "corrected": True, "cycles": 2}
    done = run_of(iso_config(tmp_path, job), true_kinematics(shift_m=0.003))
    codes = [w["code"] for w in done.result["warnings"]]
    assert "iso9283.stand" in codes
    assert done.result["result"]["registration"]["rms_m"] == pytest.approx(0.003, rel=0.05)


def test_readings_that_the_instrument_does_not_vouch_for_are_told(tmp_path: Path) -> None:
    def act(cell: ObjectCell) -> None:
        cell.at_state("measure", lambda: cell.plant.plants["tracker"].inject("doubtful", {}))

    done = run_of(iso_config(tmp_path, {"cycles": 2}), act=act)
    (told,) = [w["text"] for w in done.result["warnings"] if w["code"] == "tracker.doubtful"]
    assert told.startswith("at 10 of 10 arrivals the tracker warned: the instrument does not vouch")


def test_a_beam_that_is_broken_for_a_while_is_found_again(tmp_path: Path) -> None:
    def act(cell: ObjectCell) -> None:
        cell.at_state("measure", lambda: cell.plant.plants["tracker"].inject("beam-break", {"for_s": 1.5}))

    done = run_of(iso_config(tmp_path, {"cycles": 2, "find_timeout_s": 1.0}), act=act)
    assert done.end["outcome"] == "complete"
    assert len(done.data["samples"]) == 14
    assert "reacquire" in {str(b) for _, b in done.cell.engine.run.visited}  # type: ignore[union-attr]


def test_a_reflector_that_is_gone_ends_the_job_by_name_with_the_arm_at_rest(tmp_path: Path) -> None:
    def act(cell: ObjectCell) -> None:
        cell.at_state(
            "measure", lambda: cell.plant.plants["tracker"].inject("out-of-view", {"reflector": "smr1"})
        )

    done = run_of(iso_config(tmp_path, {"retries_per_pose": 0}), act=act)
    assert done.end["outcome"] != "complete"
    assert done.end["error"]["name"] in ("TRACKER_NO_TARGET", "TRACKER_BEAM_BROKEN")
    assert len(done.cell.notes(1, "arrival lost")) == 5


def test_a_finish_keeps_the_cycles_that_there_are(tmp_path: Path) -> None:
    tasks: list[Any] = []

    def act(cell: ObjectCell) -> None:
        def look() -> None:
            run = cell.engine.run
            if not tasks and run is not None and run.step >= 15:
                tasks.append(asyncio.ensure_future(cell.engine.finish("test")))

        cell.engine.subscribe(look)

    done = run_of(iso_config(tmp_path, {"cycles": 8}), act=act)
    assert done.end["outcome"] == "complete"
    assert done.result["result"]["cycles"] == 2
    assert "2 cycles were measured; the standard has 30" in done.result["reasons"]
    assert "arrivals could be measured" in " ".join(done.result["reasons"])


@pytest.mark.parametrize(
    ("job", "name", "told"),
    [
        ({"corrected": True}, "ISO9283_NO_KINEMATICS", "corrected = true, and no kinematics"),
        ({"registration": "kinematics"}, "ISO9283_NO_KINEMATICS", "registration = 'kinematics', and no"),
        ({"near": "nowhere"}, "ARGUMENT_INVALID", "near = 'nowhere' is not in [poses]; there is home"),
    ],
)
def test_what_is_missing_is_refused_before_anything_moves(
    tmp_path: Path, job: dict[str, Any], name: str, told: str
) -> None:
    async def main() -> None:
        async with open_cell(iso_config(tmp_path, job), job=JOB) as cell:
            failure = await refused(cell.start())
            assert failure.name == name
            assert told in str(failure)
            assert cell.engine.run is None

    run_virtual(main())


@pytest.mark.parametrize("change", [{"model": "ur5e"}, {"calibration": {"delta_a": [0.001] * 6}}])
def test_kinematics_of_an_arm_that_was_replaced_are_refused(tmp_path: Path, change: dict[str, Any]) -> None:
    async def main() -> None:
        async with open_cell(iso_config(tmp_path, {"corrected": True}), job=JOB) as cell:
            own = robot_spec(cell.config, cell.engine.context.supervisor)
            reflectors = {"tool": {"smr1": POINT.tolist()}}
            commit(cell, {**true_kinematics(), "controller": {**own, **reflectors, **change}})
            failure = await refused(cell.start())
            assert failure.name == "ISO9283_NO_KINEMATICS"
            assert "of another arm" in str(failure)
            commit(cell, {**true_kinematics(), "controller": {**own, **reflectors}})
            await cell.start()
            await cell.engine.abort("test")

    run_virtual(main())


@pytest.mark.parametrize(
    ("cube", "told"),
    [
        ({"centre": [2.5, 0.0, 0.5]}, "pose R1 with the flange at"),
        ({"centre": [-0.6, -0.5, 0.1]}, "pose R3: "),
    ],
)
def test_a_cube_that_the_arm_cannot_fill_is_refused_with_the_pose_and_nothing_moves(
    tmp_path: Path, cube: dict[str, Any], told: str
) -> None:
    whole = {"centre": CENTRE.tolist(), "edge_m": EDGE, "R_base_flange": towards_the_tracker(), **cube}
    done = run_of(iso_config(tmp_path, {"cube": whole}))
    assert done.end["error"]["name"] == "ISO9283_PLAN_REFUSED"
    assert told in done.end["error"]["text"]
    assert done.cell.notes(1, "move_joints") == []


def test_a_dry_run_lists_poses_order_and_margins_and_moves_nothing(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(iso_config(tmp_path), job=JOB) as cell:
            before = cell.plant.world.track.at(cell.clock.now())[0]
            shown = await cell.dry_run()
            plan = shown["plan"]
            names = [*(f"R{k}" for k in range(1, 5)), *(f"P{k}" for k in range(1, 6))]
            assert [p["pose"] for p in plan["poses"]] == names
            assert plan["order"] == list(ORDER)
            assert plan["arrivals"] == 19
            assert all("checks" in p for p in plan["poses"])
            np.testing.assert_array_equal(before, cell.plant.world.track.at(cell.clock.now())[0])

    run_virtual(main())


def test_without_a_nominal_place_a_person_points_the_tracker_first(tmp_path: Path) -> None:
    config = iso_config(tmp_path, {"T_base_tracker_nominal": None, "cycles": 2})

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.run and cell.engine.run.prompt, "a prompt")
            run = cell.engine.run
            assert run is not None
            assert run.prompt is not None
            assert "Point the tracker at reflector smr1" in run.prompt[1]
            assert cell.notes(run_id, "move_joints") == []
            await cell.engine.finish("test")
            while cell.engine.active:
                await cell.clock.sleep(0.05)
            assert cell.end(run_id)["error"]["name"] == "ISO9283_INCOMPLETE"

    run_virtual(main())


# -- before anything moves: cellward check


def predicted(folder: Path, **job: Any) -> dict[str, Any]:
    config = iso_config(folder, {"cycles": 30, **job})
    return iso9283_expectation(setup_of(config), Iso9283Config.model_validate(config.job_section(JOB)))


@pytest.mark.parametrize(
    ("serials", "job", "told"),
    [
        ({"arm": "20991234"}, {"corrected": True}, "with arm 20991234, and this is arm 99991100001"),
        ({"tracker": "1"}, {"registration": "kinematics"}, "with tracker 1, and this is tracker 99994400001"),
        ({"tracker": "1"}, {"corrected": True}, None),
        ({"arm": "99991100001", "tracker": "99994400001"}, {"registration": "kinematics"}, None),
    ],
)
def test_check_says_that_the_accepted_kinematics_are_of_other_devices(
    tmp_path: Path, serials: dict[str, str], job: dict[str, Any], told: str | None
) -> None:
    config = iso_config(tmp_path, {"cycles": 30, **job})
    state = Path(config.cell.state_dir)
    state.mkdir(parents=True, exist_ok=True)
    ledger = Ledger(state / "ledger.sqlite")
    value = {**true_kinematics(), "serials": serials}
    ledger.accept(ledger.propose(kinematics("arm"), value, {}, 0, None), "test")
    ledger.close()
    found = iso9283_expectation(setup_of(config), Iso9283Config.model_validate(config.job_section(JOB)))[
        "problems"
    ]
    assert len(found) == (0 if told is None else 1), found
    if told is not None:
        assert told in found[0]


def test_check_tells_arrivals_and_what_the_tracker_alone_would_read(tmp_path: Path) -> None:
    found = predicted(tmp_path)
    assert found["problems"] == found["cautions"] == []
    assert found["text"].startswith("154 arrivals at 9 poses, all free and in reach; at 2.2 m")
    assert found["tracker"]["RP"] == pytest.approx(3.616 * 29e-6, rel=0.05)


@pytest.mark.parametrize(
    ("job", "told"),
    [
        ({"max_RP_m": 0.00005}, "max_RP_m is 0.050 mm, and the tracker alone reads RP 0.10"),
        ({"near": "nowhere"}, "near = 'nowhere' is not in [poses]"),
        (
            {"cube": {"centre": [2.5, 0.0, 0.5], "edge_m": 0.3, "R_base_flange": [0.0, 0.0, 0.0]}},
            "pose R1 with the flange at",
        ),
    ],
)
def test_check_finds_what_would_make_the_test_fail(tmp_path: Path, job: dict[str, Any], told: str) -> None:
    (problem,) = predicted(tmp_path, **job)["problems"]
    assert told in problem


# -- what is on disk, whatever ended the run


def stopped_at(folder: Path, arrivals: int) -> Path:
    """The folder of a test that was aborted after so many arrivals."""

    async def main() -> Path:
        async with open_cell(iso_config(folder, {"cycles": 4}), job=JOB) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.status()["step"] >= arrivals, "arrivals", 300.0)
            await cell.engine.abort("test")
            assert (await cell.finished(run_id))["outcome"] == "stopped"
            return cell.folder(run_id).path

    return run_virtual(main())


def test_an_abort_leaves_its_arrivals_in_a_data_set_and_a_kill_leaves_them_readable(tmp_path: Path) -> None:
    folder = stopped_at(tmp_path, 15)
    path = folder / "iso9283.json"
    data, lines = read_json(path), (folder / "samples.jsonl").read_bytes()
    assert len(data["samples"]) == len(lines.splitlines()) >= 14
    whole = solve_iso9283(path, {})
    assert whole["result"]["cycles"] >= 2
    # A kill: the data set as it was before the first arrival, and half a line at the end.
    path.write_text(to_json(data | {"samples": []}), "utf-8")
    (folder / "samples.jsonl").write_bytes(lines + b'{"pose": "P')
    assert differences(whole, solve_iso9283(path, {})) == []
    (folder / "samples.jsonl").write_bytes(b"nonsense\n" + lines)
    with pytest.raises(CellError, match=r"samples\.jsonl:1: no line of a test's arrivals"):
        solve_iso9283(path, {})


def test_a_share_of_the_speed_is_one_of_each_joint() -> None:
    limits = Speed(0.5, 1.0, 2.0, 4.0, each_joint_rad_s=(1.0, 1.0, 2.0, 2.0, 2.0, 2.0))
    base_alone = speed_of(limits, 0.5).between(np.zeros(6), np.eye(6)[0])
    assert base_alone.joint_rad_s == 0.5
