"""The daemon's own moves by the calibrated arm: where its true flange goes, and which version is used."""

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from pydantic import BaseModel, ConfigDict
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.identification.registration import register
from calibration.kinematics import robot_from_spec
from cell.calibrations import kinematics, laser_reference, tool_calibration
from cell.formats.result import Result
from cell.poses import Array, exp_xi, to_pose6
from cell.procedure import Procedure, Proposal, Run
from cell.run_values import RunValues
from cell.store.files import to_json
from daemon.config import CellConfig, load_config
from fakes.object import run_virtual
from fakes.world.scenario import Scenario
from procedures.arm_setup import arm_model
from procedures.kind import Kind, add_outside
from procedures.registry import JOBS
from tests.kit.laser_cell import TOOL, laser_config
from tests.kit.laser_made import drawn_reference
from tests.kit.object_cell import ObjectCell, no_report, on_disk, open_cell, refused, write_config
from tests.kit.solved import solve_kincal
from tests.kit.tracker_cell import BRISK

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

TRUTH = Scenario.load("tracker:ideal").world.arm
ARM = kinematics("arm")
DRAWN = robot_from_spec({"model": "ur10e"})
Q_FREE = [
    [0.2, -1.5, 1.7, -1.9, -1.4, 0.3],
    [0.9, -1.2, 1.2, -1.5, -1.8, -0.4],
    [-0.7, -1.7, 1.9, -1.6, -1.3, 0.8],
    [1.5, -1.4, 1.5, -1.2, -1.6, 0.1],
    [-1.3, -1.1, 1.1, -1.9, -1.2, -0.9],
    [0.0, -1.9, 2.1, -1.4, -1.9, 0.5],
]
WANTED = [DRAWN.forward(np.array(q)) for q in Q_FREE]
STEP = exp_xi([0.08, -0.05, 0.06, 0.1, -0.05, 0.15])  # from each of them on a line, in the flange
NESTS = {"smr1": [0.06, 0.0, 0.05], "smr2": [-0.05, 0.06, 0.03], "smr3": [-0.02, -0.07, 0.07]}


KIND = Kind(name=f"{__name__}:KIND", words="procedures.plan_words:plan_lines")  # of the job below


class State(StrEnum):
    """Of the job below."""

    GO = "go"


class Keys(BaseModel):
    """It has none."""

    model_config = ConfigDict(extra="forbid")


class GoThere(Procedure):
    """Goes to wanted flange poses, by joints and on lines; what it saw and where it stood is kept."""

    name: ClassVar[str] = "go-there"
    kind: ClassVar[str] = KIND.name
    number: ClassVar[int] = 99
    Config = Keys
    State = State
    TRANSITIONS: ClassVar[Mapping[Any, frozenset[Any]]] = {None: frozenset({State.GO}), State.GO: frozenset()}
    CHECKPOINTS: ClassVar[frozenset[Any]] = frozenset()

    def __init__(self, config: Any) -> None:
        super().__init__(config)
        GoThere.went = []

    went: ClassVar[list[tuple[RigidTransform, RigidTransform, Array]]] = []

    def uses(self) -> tuple[str, ...]:
        return ("arm",)

    def proposal(self, run: Run) -> Proposal | None:
        return Proposal(tool_calibration(run.values.tool["name"]), [0.0] * 6, False)

    async def run(self, run: Run) -> None:
        await run.enter(State.GO)
        model = arm_model(run.values)
        async with run.motion() as lease:
            for T, q in zip(WANTED, Q_FREE, strict=True):
                found = model.inverse(T, np.array(q))
                assert found is not None
                await lease.move_joints(found)
                self._keep(run, T)
                await lease.move_linear(T * STEP)
                self._keep(run, T * STEP)
        run.result = Result(kind=self.kind, verdict="pass", result={"poses": len(self.went)})

    def _keep(self, run: Run, wanted: RigidTransform) -> None:
        state = run.arm().state.latest(0.1).value
        self.went.append((wanted, state.T_base_flange, state.q))

    async def dry_run(self, run: Run) -> dict[str, Any]:
        return {"poses": []}


def config_of(folder: Path, use: bool) -> CellConfig:
    write_config(folder, "tracker:ideal", limits=BRISK)
    return switched(folder, use)


def switched(folder: Path, use: bool) -> CellConfig:
    """The configuration that was just written to ``folder``, with the switch."""
    path = folder / "cell.toml"
    path.write_text(path.read_text().replace("[robot]", f"[robot]\nuse_kinematics = {str(use).lower()}", 1))
    return load_config(path)


def with_job(cell: ObjectCell) -> ObjectCell:
    add_outside(KIND.name)
    cell.engine.needs.jobs = {**JOBS, GoThere.name: GoThere}
    cell.job = GoThere.name
    return cell


def perfect(**more: Any) -> dict[str, Any]:
    """What a calibration without noise and gauge would have found of the tracker's arm."""
    robot = {"model": TRUTH.model, "calibration": {k: list(v) for k, v in TRUTH.error.model_dump().items()}}
    return {"robot": robot, "controller": {"model": "ur10e"}, "payload_kg": 0.8, **more}


def measured(cell: ObjectCell, folder: Path) -> dict[str, Any]:
    """What the solver finds from 90 readings of a tracker, three nests on the flange, poses at random."""
    rng = np.random.default_rng(4)
    Q = rng.uniform([-3, -2.6, 0.4, -2.6, -2.6, -3], [3, -0.5, 2.4, 2.6, 2.6, 3], (90, 6))
    stand = RigidTransform.from_components([-2.4, -1.7, 1.1], Rotation.from_rotvec([0.0, 0.0, -0.9]))
    samples = []
    for k, q in enumerate(Q):
        target = f"smr{k % 3 + 1}"
        p = stand.inv().apply(cell.plant.world.true.forward(q).apply(NESTS[target]))
        p += rng.normal(0.0, 15e-6 + 6e-6 * np.linalg.norm(p), 3)
        samples.append({"q": q.tolist(), "p_tracker": p.tolist(), "target": target})
    path = folder / "kincal.json"
    robot = {"model": "ur10e", "tool": NESTS}
    noise = {"sigma0": 15e-6, "sigma_per_m": 6e-6}
    path.write_text(
        to_json({"schema": "cellward.kincal/1", "robot": robot, "noise": noise, "samples": samples})
    )
    answer = solve_kincal(path)["result"]
    assert answer is not None
    serials = {"arm": TRUTH.serial}
    return perfect(robot=answer["robot"], serials=serials)


def commit(cell: ObjectCell, name: str, value: Any, model: Mapping[str, Any] | None = None) -> int:
    row = cell.ledger.propose(name, value, {}, 0, cell.config.robot.T_base_camera_nominal, model)
    on_disk(cell.ledger.accept, row, "test")
    return row


def off(cell: ObjectCell, nests: Mapping[str, Any]) -> tuple[float, float]:
    """RMS m: the true nests from where they were wanted, joint moves and lines apart.

    In the base that suits all of them best: a tracker cannot tell where the arm's own base is. ``nests`` are
    their places on the flange as the model in use has them.
    """
    names = sorted(NESTS)
    wanted = np.concatenate([T.apply([nests[n] for n in names]) for T, _, _ in GoThere.went])
    true = np.concatenate(
        [cell.plant.world.true.forward(q).apply([NESTS[n] for n in names]) for _, _, q in GoThere.went]
    )
    place = register(wanted.T, true.T, np.ones(len(true)))
    away = np.linalg.norm(place.to_tracker(true.T).T - wanted, axis=1).reshape(-1, 2, len(names))
    moved, lines = np.sqrt(np.mean(away**2, axis=(0, 2)))
    return float(moved), float(lines)


@pytest.mark.parametrize("use", [False, True])
def test_the_true_flange_goes_where_it_is_wanted_when_the_calibrated_arm_is_used(
    tmp_path: Path, use: bool
) -> None:
    async def main() -> tuple[float, float]:
        async with open_cell(config_of(tmp_path, use)) as cell:
            value = measured(cell, tmp_path)
            commit(cell, ARM, value)
            end = await with_job(cell).run_job()
            assert (end["outcome"], end["error"]) == ("complete", None)
            assert len(GoThere.went) == 12
            for wanted, seen, _ in GoThere.went:  # as the model in use has it, it is always there
                np.testing.assert_allclose(to_pose6(seen), to_pose6(wanted), atol=2e-5)
            return off(cell, value["robot"]["tool"] if use else NESTS)

    moved, lines = run_virtual(main())
    print(f"use_kinematics = {use}: joint moves {1e3 * moved:.4f} mm, lines {1e3 * lines:.4f} mm (RMS)")
    if use:
        assert max(moved, lines) < 5e-5
    else:
        assert min(moved, lines) > 5e-4


def test_the_ledger_and_the_result_name_the_model(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(config_of(tmp_path, True)) as cell:
            commit(cell, ARM, perfect())
            with_job(cell)
            await cell.run_job()
            now = {"name": ARM, "version": 1}
            assert cell.result(1)["inputs"]["arm_model"] == now
            (row,) = [r for r in cell.ledger.results() if r["name"].startswith("T_flange_tool")]
            assert row["arm_model"] == now
            assert cell.ledger.result(row["id"])["result"]["inputs"]["arm_model"] == now
            (note,) = cell.notes(1, "arm model")
            assert note["words"] == "kinematics.arm version 1"
            assert cell.folder(1).info["values"]["arm_model"] == now

    run_virtual(main())


def test_a_version_that_is_only_proposed_is_never_used(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(config_of(tmp_path, True)) as cell:
            proposed = cell.ledger.propose(ARM, perfect(), {}, 0, None)
            with_job(cell)
            assert (await refused(cell.start())).name == "KINEMATICS_MISSING"
            on_disk(cell.ledger.accept, proposed, "test", commit=False)
            assert (await refused(cell.start())).name == "KINEMATICS_MISSING"
            on_disk(cell.ledger.commit, proposed)
            worse = perfect()
            worse["robot"] = {"model": "ur10e"}
            cell.ledger.propose(ARM, worse, {}, 0, None)
            await cell.run_job()
            model = robot_from_spec(perfect()["robot"])
            for wanted, _, q in GoThere.went:
                np.testing.assert_allclose(model.forward(q).translation, wanted.translation, atol=2e-5)
            on_disk(cell.ledger.rollback, ARM, "test")
            assert (await refused(cell.start())).name == "KINEMATICS_MISSING"

    run_virtual(main())


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (perfect(serials={"arm": "9999-7"}), "measured with arm 9999-7, and this is arm 99991100001"),
        (perfect(controller={"model": "ur5e"}), "its model or factory calibration is not that of"),
        (
            perfect(controller={"model": "ur10e", "calibration": {"delta_a": [1e-4] * 6}}),
            "its model or factory calibration is not that of",
        ),
    ],
)
def test_kinematics_of_another_arm_are_refused(tmp_path: Path, value: dict[str, Any], told: str) -> None:
    async def main() -> None:
        async with open_cell(config_of(tmp_path, True)) as cell:
            commit(cell, ARM, value)
            failure = await refused(with_job(cell).start())
            assert failure.name == "KINEMATICS_OTHER_ARM"
            assert told in str(failure)

    run_virtual(main())


def test_a_controller_that_believes_something_else_than_is_known_moves_nothing(tmp_path: Path) -> None:
    calibration = {"delta_a": [0.0, 0.0008, 0.0, 0.0, 0.0, 0.0]}
    spec = {"model": "ur10e", "calibration": calibration}

    async def main() -> None:
        believed = tmp_path / "believed.json"
        believed.write_text(to_json(spec))
        config_of(tmp_path, True)
        text = (tmp_path / "cell.toml").read_text().replace('model = "ur10e"', 'model = "believed.json"')
        (tmp_path / "cell.toml").write_text(text)
        config = load_config(tmp_path / "cell.toml")
        async with open_cell(config) as cell:
            commit(cell, ARM, perfect(controller=spec))
            end = await with_job(cell).run_job()
            assert end["error"]["name"] == "KINEMATICS_OTHER_ARM"
            assert "the controller reports the flange" in end["error"]["text"]
            assert GoThere.went == []
            assert cell.at_rest()

    run_virtual(main())


def test_off_is_what_it_was_and_an_accepted_version_changes_nothing(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(config_of(tmp_path, False)) as cell:
            commit(cell, ARM, perfect())
            await with_job(cell).run_job()
            assert cell.result(1)["inputs"]["arm_model"] == {"name": "controller"}
            for wanted, seen, q in GoThere.went:
                np.testing.assert_allclose(DRAWN.forward(q).translation, wanted.translation, atol=2e-5)
                np.testing.assert_allclose(seen.translation, wanted.translation, atol=2e-5)

    run_virtual(main())


def test_the_jobs_that_look_at_the_arm_itself_need_no_version(tmp_path: Path) -> None:
    judging = {name for name, job in JOBS.items() if job.judges_arm}
    assert judging == {"tracker-sampling", "iso9283", "corrected-targets"}
    config = config_of(tmp_path, True)

    async def main() -> None:
        async with open_cell(config) as cell:
            values = RunValues({"model": "ur10e"}, use_kinematics=True)
            from daemon.values import with_arm_model

            class Judge(GoThere):
                judges_arm: ClassVar[bool] = True

            found = with_arm_model(values, Judge(Keys()), config, cell.supervisor)
            assert found.arm_model == {"name": "controller"}

    run_virtual(main())


def test_another_load_and_a_tool_of_another_model_are_told_in_the_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(GoThere, "proposal", lambda job, run: None)  # what a run renews is not warned of

    async def main() -> None:
        async with open_cell(config_of(tmp_path, True)) as cell:
            commit(cell, ARM, perfect(payload_kg=3.0))
            tool = list(cell.config.robot.tool.T_flange_tool)
            name = f"T_flange_tool.{cell.config.robot.tool.name}"
            on_disk(cell.ledger.accept, cell.ledger.propose(name, tool, {}, 0, tool), "test")
            await with_job(cell).run_job()
            result = cell.result(1)
            told = {w["code"]: w["text"] for w in result["warnings"]}
            assert told["kinematics.payload"].startswith("the kinematics in effect were measured with 3 kg")
            assert told["kinematics.differ"] == (
                f"{name} version 1 was made with the controller's own kinematics, and this run works with "
                "kinematics.arm version 1"
            )
            assert result["verdict"] == "pass"
            assert cell.notes(1, "made with another arm model")

    run_virtual(main())


def test_a_reference_keeps_the_model_it_was_made_with_and_fits_a_check_that_follows(tmp_path: Path) -> None:
    laser_config(tmp_path, {"max_U_m": 0.01, "max_slope_rad": 0.1, "max_plane_gap_m": 0.01})
    config, error = switched(tmp_path, True), Scenario.load("laser").world.arm.error.model_dump()
    value = {"robot": {"model": "ur10e", "calibration": {k: list(v) for k, v in error.items()}}}

    async def main() -> None:
        async with open_cell(config, job="laser-reference") as cell:
            commit(cell, ARM, value)
            end = await cell.run_job()
            assert (end["outcome"], end["error"]) == ("complete", None)
            (row,) = cell.ledger.results(laser_reference(TOOL))
            assert row["arm_model"] == {"name": ARM, "version": 1}
            on_disk(cell.ledger.accept, row["id"], "test")
            run_id = await cell.start(job="laser-check")
            await cell.engine.abort("test")
            await cell.finished(run_id)
            commit(cell, ARM, value)  # a new version is another model
            assert (await refused(cell.start(job="laser-check"))).name == "KINEMATICS_DIFFER"

    run_virtual(main())


def test_a_reference_of_beams_made_with_another_model_is_refused(tmp_path: Path) -> None:
    value = {"robot": {"model": "ur10e", "calibration": {"delta_a": [0.0, 0.001, 0.0, 0.0, 0.0, 0.0]}}}
    laser_config(tmp_path)
    config = switched(tmp_path, True)
    reference = drawn_reference(config)

    async def main() -> None:
        async with open_cell(config, job="laser-check") as cell:
            commit(cell, ARM, value)
            for model, name in (
                (None, "KINEMATICS_DIFFER"),
                ({"name": "controller"}, "KINEMATICS_DIFFER"),
                ({"name": ARM, "version": 2}, "KINEMATICS_DIFFER"),
            ):
                commit(cell, laser_reference(TOOL), reference, model)
                failure = await refused(cell.start())
                assert failure.name == name
                assert laser_reference(TOOL) in str(failure)
            commit(cell, laser_reference(TOOL), reference, {"name": ARM, "version": 1})
            run_id = await cell.start()
            await cell.engine.abort("test")
            await cell.finished(run_id)

    run_virtual(main())
