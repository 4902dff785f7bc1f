"""What goes wrong while an arm that is only read is sampled."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.devices import JointState
from cell.errors import CellError
from cell.samples import Sample, Stream
from fakes.object import run_virtual
from procedures.tracker.arms import WatchedArm
from procedures.tracker.record import SampleRecord
from tests.kit.object_cell import ObjectCell, no_report, open_cell, refused
from tests.kit.tracker_cell import JOB, tracker_config
from tests.kit.tracker_runs import at_pose, error_of, run

__all__ = ["no_report"]

pytestmark = pytest.mark.usefixtures("no_report")


def test_an_arm_that_has_not_gone_where_it_was_asked_to_is_not_measured_twice_at_one_place(
    tmp_path: Path,
) -> None:
    """Else a reading set aside would be one of those that were solved."""
    skip = at_pose(3, "palletizer", "skip-pose")
    end, cell = run(tmp_path, skip, {"poses": 14}, scenario="palletizer:ideal")
    assert end["outcome"] == "complete", end
    (skipped,) = cell.notes(1, "pose skipped")
    assert "it stands where it was measured before" in skipped["why"]
    assert not [note for note in cell.notes(1, "pose taken") if note.get("off_rad")]
    assert cell.result(1)["inputs"]["sampling"]["measured"] == 14
    Q = np.array([s["q"] for s in SampleRecord.read(cell.folder(1).path).samples])
    apart = np.abs(Q[:, None] - Q).max(axis=2) + np.eye(len(Q))
    assert apart.min() > 0.02


def test_an_arm_that_is_not_where_it_was_asked_to_be_is_measured_as_it_stands_and_told(
    tmp_path: Path,
) -> None:
    jog = at_pose(3, "palletizer", "unasked-move", rad=0.05)
    end, cell = run(tmp_path, jog, {"poses": 14}, scenario="palletizer:ideal")
    assert end["outcome"] == "complete", end
    (elsewhere,) = [note for note in cell.notes(1, "pose taken") if note.get("off_rad")]
    assert elsewhere["off_rad"] > 0.02
    found = cell.result(1)
    assert found["inputs"]["sampling"]["off_plan"] == 1
    assert found["verdict"] == "warn"
    (told,) = [w["text"] for w in found["warnings"] if w["code"] == "samples.off-plan"]
    assert told.startswith("1 of 14 poses were measured elsewhere than was asked")
    assert found["heldout"]["set_aside"]["rms"]["calibrated"] < 0.0003


class _Joints:
    """What an observed arm that writes once at each rest, or every ``period_s``, has given."""

    name = "arm"

    def __init__(self, period_s: float | None) -> None:
        self.period_s = period_s
        self.clock: Any = SimpleNamespace(now=lambda: 10.0)
        self.joints: Stream[JointState] = Stream("arm", self.clock)

    def gave(self, t: float, q: float, at_rest: bool = True) -> None:
        self.joints.push(Sample(JointState(np.array([q]), at_rest, None), t, 0.1, self.joints.received))

    def watched(self, asked_t: float) -> WatchedArm:
        live: Any = SimpleNamespace(observed_arm=lambda: self, clock=self.clock)
        arm = WatchedArm(live, None)  # type: ignore[arg-type]
        arm._asked_t = asked_t
        return arm


def test_an_arm_that_writes_at_each_rest_is_where_it_wrote_last_before_the_measurement() -> None:
    arm = _Joints(None)
    for t, q in ((2.0, 0.1), (5.0, 0.2)):
        arm.gave(t, q)
    assert arm.watched(1.0).joints(7.0, 8.0).tolist() == [[0.2]]
    arm.gave(9.0, 0.3)
    rows = arm.watched(1.0).joints(7.0, 8.0).tolist()
    assert rows == [[0.2], [0.3]], "it moved meanwhile or since, which the caller sees"
    with pytest.raises(CellError, match="gave no joints"):
        arm.watched(8.95).joints(7.0, 8.0)


def test_an_arm_that_is_polled_and_gave_no_joints_while_it_was_measured_is_stale() -> None:
    arm = _Joints(0.05)
    arm.gave(5.0, 0.1)
    with pytest.raises(CellError, match="gave no joints") as caught:
        arm.watched(1.0).joints(7.0, 8.0)
    assert caught.value.name == "STALE_DATA"
    arm.gave(7.5, 0.1, at_rest=False)
    with pytest.raises(CellError, match="moved while") as caught:
        arm.watched(1.0).joints(7.0, 8.0)
    assert caught.value.name == "POSE_UNSTABLE"


def test_readings_that_the_tracker_does_not_vouch_for_are_told(tmp_path: Path) -> None:
    def doubt(cell: ObjectCell) -> None:
        cell.at_state("measure", lambda: cell.plant.plants["tracker"].inject("doubtful", {}))

    end, cell = run(tmp_path, doubt, scenario="palletizer:ideal")
    assert end["verdict"] == "warn"
    (told,) = [w["text"] for w in cell.result(1)["warnings"] if w["code"] == "tracker.doubtful"]
    assert told.startswith("at 12 of 12 poses the tracker warned: the instrument does not vouch")
    assert len(cell.result(1)["inputs"]["sampling"]["doubtful"]) == 12


def test_an_arm_that_never_gets_to_a_pose_is_not_waited_for_forever(tmp_path: Path) -> None:
    """Its program refuses poses outside its own limits, which the job's config has wrong."""
    beyond = [[2.45, 2.6], [0.8, 2.1], [-2.2, -0.6], [-3.0, 3.0]]
    job = {"joint_ranges_rad": beyond, "poses": 12, "request_timeout_s": 8.0}
    end, _ = run(tmp_path, lambda cell: None, job, scenario="palletizer:ideal")
    assert error_of(end) == "OBSERVED_ARM_NOT_THERE"
    assert "palletizer is at rest and shows no number, not 4, within 8 s" in end["error"]["text"]


def test_an_arm_that_moves_while_it_is_measured_is_measured_again(tmp_path: Path) -> None:
    jog = at_pose(3, "palletizer", "unasked-move", 0.05, rad=0.002)
    end, cell = run(tmp_path, jog, {"poses": 12}, scenario="palletizer:ideal")
    assert end["outcome"] == "complete", end
    assert cell.notes(1, "pose failed")
    assert cell.result(1)["heldout"]["set_aside"]["rms"]["calibrated"] < 0.0003


def test_without_a_handshake_a_person_moves_the_arm_and_it_is_measured_as_it_stands(tmp_path: Path) -> None:
    async def main() -> None:
        config = tracker_config(
            tmp_path, {"poses": 12}, scenario="palletizer:ideal", observed_keys={"handshake": False}
        )
        async with open_cell(config, job=JOB) as cell:
            arm = cell.plant.world.observed
            assert arm is not None
            run_id = await cell.start()
            asked = 0
            while cell.engine.active:
                live = cell.engine.run
                if live is not None and live.prompt is not None and "move palletizer to" in live.prompt[1]:
                    wanted = live.prompt[1].split(" move palletizer to ")[1].split(" deg")[0]
                    q = np.radians([float(v) for v in wanted.split(", ")]) + 0.003
                    cell.plant.observed.settle_past()
                    arm.go(cell.clock.now(), np.clip(q, *np.array(arm.truth.limits).T))
                    await cell.clock.sleep(6.0)
                    await cell.engine.confirm(live.prompt[0], "test")
                    asked += 1
                await cell.clock.sleep(0.05)
            end = cell.end(run_id)
            assert end["outcome"] == "complete", end
            assert asked >= 12
            aside = cell.result(run_id)["heldout"]["set_aside"]
            assert aside["rms"]["calibrated"] < 0.0003 < 0.002 < aside["rms"]["registration_only"]

    run_virtual(main())


def test_an_observed_arm_without_a_model_is_refused(tmp_path: Path) -> None:
    async def main() -> None:
        config = tracker_config(tmp_path, {"poses": 12}, scenario="palletizer:ideal")
        robot = config.robot.model_copy(update={"observed_spec": None})
        async with open_cell(config.model_copy(update={"robot": robot}), job=JOB) as cell:
            assert (await refused(cell.start())).name == "OBSERVED_MODEL_MISSING"

    run_virtual(main())
