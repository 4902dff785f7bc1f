"""What goes wrong while an arm is sampled is tried again, refused or told by its name."""

import asyncio
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calibration.identification.registration import Registration
from cell.errors import CellError
from cell.poses import Array
from cell.samples import Sample
from cell.store.files import read_json
from fakes.object import run_virtual
from fakes.object.tracker import ObjectTracker
from procedures.laser_tracker.locating import locate
from procedures.tracker.monuments import Moved, compare, drift_summary, moved_text
from procedures.tracker.record import SampleRecord
from procedures.tracker.watch import MonumentWatch
from tests.kit.object_cell import ObjectCell, no_report, open_cell, refused
from tests.kit.tracker_cell import JOB, tracker_config
from tests.kit.tracker_runs import at_monuments, at_pose, error_of, run

__all__ = ["no_report"]

pytestmark = pytest.mark.usefixtures("no_report")


# -- the beam


def test_a_beam_that_is_broken_for_a_moment_is_found_again_and_no_pose_is_lost(tmp_path: Path) -> None:
    end, cell = run(tmp_path, at_pose(3, "tracker", "beam-break", 0.05, duration_s=2.7))
    assert end["outcome"] == "complete"
    (failed,) = cell.notes(1, "pose failed")
    assert re.search("lost its reflector|finds no reflector", failed["why"])
    assert not cell.notes(1, "pose skipped")
    assert cell.result(1)["inputs"]["sampling"]["measured"] == 12
    assert [line["state"] for line in cell.journal(1) if line.get("state") == "reacquire"]


def test_a_pose_that_cannot_be_seen_comes_again_after_the_others(tmp_path: Path) -> None:
    end, cell = run(tmp_path, at_pose(3, "tracker", "out-of-view", duration_s=4.0), {"retries_per_pose": 0})
    assert end["outcome"] == "complete"
    assert cell.notes(1, "pose skipped")
    assert cell.result(1)["inputs"]["sampling"]["lost"] == []
    assert cell.result(1)["inputs"]["sampling"]["measured"] == 12


def test_a_beam_that_stays_broken_ends_the_job_by_its_name_with_the_arm_at_rest(tmp_path: Path) -> None:
    end, cell = run(tmp_path, at_monuments("beam-break", reflector="smr1"), {"retries_per_pose": 1})
    assert end["outcome"] == "aborted"
    assert error_of(end) in ("TRACKER_BEAM_BROKEN", "TRACKER_NO_TARGET")
    assert len(cell.notes(1, "pose skipped")) == 5
    assert cell.at_rest()


def test_what_was_measured_before_a_failure_is_in_data_sets_and_the_way_on_is_told(tmp_path: Path) -> None:
    gone = at_pose(3, "tracker", "beam-break", reflector="smr1")
    end, cell = run(tmp_path, gone, {"retries_per_pose": 0}, scenario="palletizer:ideal")
    assert error_of(end) in ("TRACKER_BEAM_BROKEN", "TRACKER_NO_TARGET")
    assert "3 poses are kept, `cellward adopt 1` goes on from them" in end["error"]["text"]
    sets = [read_json(cell.folder(1).path / name)["samples"] for name in ("kincal.json", "heldout.json")]
    assert sum(map(len, sets)) == 3


def test_a_reflector_that_the_tracker_does_not_know_ends_the_job_before_anything_moves(
    tmp_path: Path,
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        genuine = ObjectTracker.select

        async def select(tracker: ObjectTracker, name: str) -> None:
            await genuine(tracker, "nobody" if name == "m3" else name)

        patch.setattr(ObjectTracker, "select", select)
        end, cell = run(tmp_path, lambda cell: None)
    assert error_of(end) == "TRACKER_REFLECTOR_UNKNOWN"
    assert not moved(cell)


def test_a_point_that_shakes_is_tried_again_and_told_when_it_stays_so(tmp_path: Path) -> None:
    shake = at_pose(0, "tracker", "vibration", m=0.002)
    end, _ = run(tmp_path, shake, {"retries_per_pose": 0, "measure_timeout_s": 1.0})
    assert error_of(end) == "TRACKER_UNSTABLE"
    assert "scatter" in end["error"]["text"]


def test_a_reflector_that_is_not_where_it_should_be_is_not_taken_for_it(tmp_path: Path) -> None:
    smr1 = {"point": [-0.05, 0.0, 0.26], "normal": [0, 0, 1], "half_angle_rad": 0.9}
    job: dict[str, Any] = {"reflectors": {"smr1": smr1}}
    job |= {"max_locate_error_m": 0.3, "max_surprise_m": 0.02}
    end, cell = run(tmp_path, lambda cell: None, job)
    # Seen too far away, not seen where it is searched for, or no place of the tracker explains all of them.
    assert error_of(end) in ("TRACKER_WRONG_TARGET", "TRACKER_NO_TARGET", "TRACKER_NOT_LOCATED")
    assert not (cell.folder(1).path / "result.json").exists()


# -- the stand


def test_a_stand_that_was_moved_is_detected_by_the_monuments_and_named(tmp_path: Path) -> None:
    end, cell = run(tmp_path, at_pose(6, "tracker", "stand-moved", dx=0.0008))
    assert error_of(end) == "TRACKER_MOVED"
    assert re.search(r"the tracker's stand moved: m\d by 0\.[78]\d\d mm, m\d by", end["error"]["text"])
    assert not (cell.folder(1).path / "result.json").exists()


def test_a_stand_that_creeps_within_the_limit_is_warned_of(tmp_path: Path) -> None:
    first = {
        "m1": {"p_tracker": [3.0, 0.0, 0.0], "sigma_m": 3e-5},
        "m2": {"p_tracker": [0, 3.0, 0], "sigma_m": 3e-5},
    }
    crept = {n: {**p, "p_tracker": list(np.add(p["p_tracker"], [0.00025, 0, 0]))} for n, p in first.items()}
    looks = [{"after": 0, "t": 0.0, "points": first}, {"after": 10, "t": 60.0, "points": crept}]
    found = drift_summary(looks, 0.0005, 12)
    assert found is not None
    assert found["beyond_noise"]
    assert found["max_moved_m"] == pytest.approx(0.00025)
    assert found["samples_since_last_look"] == 2
    assert moved_text(compare(first, crept), 0.0005) is None
    assert "the tracker's stand moved" in (moved_text(compare(first, crept), 0.0001) or "")


class _Run:
    clock = SimpleNamespace(now=lambda: 1.0)

    async def enter(self, *_: object) -> None: ...

    def note(self, *_: object, **__: object) -> None: ...

    async def take_step(self, what: str, work: Any, **_: object) -> Any:
        return await work()


class _Eye:
    """Sees every monument 5 mm further off at each look."""

    def __init__(self) -> None:
        self.shift_m, self.seen = 0.0, list[str]()

    async def measure(self, name: str, near: Array, trust_m: float) -> Sample[Any]:
        self.seen.append(name)
        point = 3.0 * np.eye(3)[int(name[1]) - 1] + [self.shift_m, 0.0, 0.0]
        return Sample(SimpleNamespace(point=point, scatter_m=0.0), 0.0, 0.0, 0)

    def sigma_m(self, point: Array) -> float:
        return 3e-5


def looks(folder: Path, shift_m: float, *hidden: tuple[bool, bool, bool]) -> tuple[SampleRecord, list[str]]:
    """The looks of which each has these of m1, m2, m3 behind the arm; what was seen at the last."""
    config = SimpleNamespace(
        monuments={name: SimpleNamespace(point=[0.0, 0.0, 0.0]) for name in ("m1", "m2", "m3")},
        swap_by_operator=False,
        retries_per_pose=1,
        max_drift_m=0.0001,
    )
    record, eye = SampleRecord(folder), _Eye()
    run: Any = _Run()
    watch = MonumentWatch(run, config, eye, record)  # type: ignore[arg-type]
    place = Registration(np.eye(3), np.zeros(3))

    async def all_looks() -> None:
        for k, behind in enumerate(hidden):
            eye.shift_m = shift_m * k
            eye.seen = []
            await watch.look(place, np.array(behind))

    asyncio.run(all_looks())
    return record, eye.seen


def test_a_look_that_has_nothing_in_common_with_the_first_one_tries_what_the_arm_may_hide(
    tmp_path: Path,
) -> None:
    _, seen = looks(tmp_path, 0.0, (False, False, True), (True, True, False))
    assert seen == ["m1", "m2", "m3"]
    (tmp_path / "moved").mkdir()
    with pytest.raises(CellError, match=r"m1 by 5\.000 mm, m2 by 5\.000 mm") as caught:
        looks(tmp_path / "moved", 0.005, (False, False, True), (True, True, False))
    assert caught.value.name == "TRACKER_MOVED"


def test_a_look_that_compares_nothing_is_no_look_in_the_summary() -> None:
    first, other = ({name: {"p_tracker": [3.0, 0.0, 0.0], "sigma_m": 3e-5}} for name in ("m1", "m3"))
    at = [{"after": after, "t": 0.0, "points": p} for after, p in ((0, first), (10, first), (20, other))]
    found = drift_summary(at, 0.0001, 20)
    assert found is not None
    assert [look["after"] for look in found["looks"]] == [10]
    assert found["samples_since_last_look"] == 10


def test_one_monument_that_moved_is_not_blamed_on_the_stand() -> None:
    still, gone = np.zeros(3), np.array([0.0, 0.004, 0.0])
    moved = [Moved("m1", still, 4e-5), Moved("m2", gone, 4e-5), Moved("m3", still, 4e-5)]
    assert (moved_text(moved, 0.0001) or "").startswith("monument m2 moved, the others stand: m2 by 4.000 mm")


def test_noise_of_a_coarse_instrument_is_no_move() -> None:
    assert moved_text([Moved("m1", np.array([0.002, 0.0, 0.0]), 0.001)], 0.0001) is None


def test_a_run_without_monuments_says_that_nothing_vouches_for_the_stand(tmp_path: Path) -> None:
    end, cell = run(tmp_path, lambda cell: None, {"monuments": {}})
    assert end["verdict"] == "warn"
    assert "tracker.no-monuments" in [w["code"] for w in cell.result(1)["warnings"]]


# -- before anything moves


def moved(cell: ObjectCell) -> bool:
    return any(line["kind"] == "motion" for line in cell.journal(1))


def test_a_plan_that_cannot_determine_the_arm_ends_the_job_before_a_lease(tmp_path: Path) -> None:
    still = [[-2, 2], [-2.2, -0.8], [1.8, 1.8], [-2, 2], [-2, 2], [-2, 2]]
    end, cell = run(tmp_path, lambda cell: None, {"joint_ranges_rad": still})
    assert error_of(end) == "TRACKER_PLAN_UNOBSERVABLE"
    assert "joint 3 does not move" in end["error"]["text"]
    assert not moved(cell)


def test_another_payload_than_the_controller_is_told_is_refused_before_a_run(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(tracker_config(tmp_path, {"payload_kg": 5.0}), job=JOB) as cell:
            refusal = await refused(cell.start())
            assert refusal.name == "PAYLOAD_DIFFERS"
            assert "5 kg" in str(refusal)
            assert "0.8 kg" in str(refusal)

    run_virtual(main())


def test_a_dry_run_lists_the_plan_with_its_checks_and_moves_nothing(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(tracker_config(tmp_path), job=JOB) as cell:
            shown = await cell.dry_run()
            plan = shown["plan"]
            assert len(plan["poses"]) == 12
            assert all(pose["checks"]["self_m"] > 0.0 for pose in plan["poses"])
            assert 0.0 < plan["predicted"]["rms_m"] < plan["predicted"]["error_95_max_m"]
            assert plan["source_rule"]["kept"] is False
            assert not moved(cell)

    run_virtual(main())


# -- the tracker's place


def test_points_on_a_line_do_not_locate_a_tracker() -> None:
    p = np.linspace(0, 1, 4)[:, None] * np.array([[1.0, 0.0, 0.0]])
    with pytest.raises(CellError, match="lie on a line"):
        locate(p, p, 0.01)


def test_an_arm_that_is_not_the_drawn_one_is_not_located() -> None:
    rng = np.random.default_rng(0)
    p: Array = rng.normal(size=(5, 3))
    with pytest.raises(CellError, match="max_locate_error_m is 10 mm") as caught:
        locate(p, p + 0.05 * rng.normal(size=(5, 3)), 0.01)
    assert caught.value.name == "TRACKER_NOT_LOCATED"


def test_without_a_nominal_place_the_operator_points_the_tracker_and_the_job_finds_it(tmp_path: Path) -> None:
    """The arm stands so that the reflector looks at the tracker, as the operator has put it."""

    async def main() -> None:
        config = tracker_config(tmp_path, {"T_base_tracker_nominal": None})
        async with open_cell(config, job=JOB) as cell:
            world = cell.plant.world
            assert world.tracker is not None
            run_id = await cell.start()
            while cell.engine.active:
                live = cell.engine.run
                if live is not None and live.prompt is not None:
                    assert "Point the tracker at reflector smr1" in live.prompt[1]
                    world.tracker.lock(cell.clock.now(), "smr1")
                    await cell.engine.confirm(live.prompt[0], "test")
                await cell.clock.sleep(0.05)
            end = cell.end(run_id)
            assert end["outcome"] == "complete", end
            (found,) = cell.notes(run_id, "located")
            true = world.tracker.truth.T_base_tracker
            assert np.linalg.norm(np.subtract(found["T_base_tracker"][:3], true[:3])) < 0.03

    run_virtual(main())
