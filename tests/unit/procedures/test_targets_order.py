"""Targets of a check of a fixed camera that have no way from where the arm stands: others first."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from cell.errors import error
from cell.guard import MotionGuard
from cell.poses import Array
from fakes.object import run_virtual
from procedures.eye_to_hand import targets
from procedures.eye_to_hand.targets import TargetMove, plan_moves
from tests.kit.check_cell import STEPS, check_cell, config, driven_run, wanted
from tests.kit.object_cell import ObjectCell, no_report

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

HOME = 0
Ways = set[tuple[int, int]]


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[TargetMove]]:
    """Three targets, whose places are 1, 2 and 3, for a guard that refuses these ways: from, to."""

    def plan(*refused: tuple[int, int]) -> list[TargetMove]:
        def check(q0: Array, q1: Array) -> None:
            if (way := (round(q0[0]), round(q1[0]))) in refused:
                raise error("MOTION_COLLISION", f"from {way[0]} to {way[1]}")

        def inverse(command: RigidTransform, near: Array) -> Array:
            return np.full(6, command.translation[0])

        guard = SimpleNamespace(
            model=SimpleNamespace(inverse=inverse),
            check_path_joints=check,
            describe=lambda q: SimpleNamespace(as_dict=lambda: {"at": float(q[0])}),
        )
        monkeypatch.setattr(targets, "lease_settings", lambda values: (guard, None, None))
        values: Any = None
        view: Any = SimpleNamespace(fault=lambda target: None)
        commands = [(k, "given", [k + 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]) for k in range(3)]
        nowhere = [float(HOME)] * 6
        return plan_moves(values, view, [[]] * 3, commands, [[]] * 3, nowhere, nowhere)  # type: ignore[arg-type]

    return plan


def numbers(moves: list[TargetMove]) -> list[int]:
    return [m.target + 1 for m in moves if not m.why]


def test_one_that_has_a_way_from_another_only_comes_after_that(
    planned: Callable[..., list[TargetMove]],
) -> None:
    assert numbers(planned()) == [1, 2, 3]
    assert numbers(planned((HOME, 1))) == [2, 1, 3]
    assert numbers(planned((HOME, 1), (2, 1))) == [2, 3, 1]
    assert numbers(planned((HOME, 1), (HOME, 2))) == [3, 1, 2]


def test_those_that_no_order_reaches_are_named_with_the_first_reason(
    planned: Callable[..., list[TargetMove]],
) -> None:
    moves = planned((HOME, 2), (1, 2), (3, 2))
    assert numbers(moves) == [1, 3]
    (left,) = [m for m in moves if m.why]
    assert (left.target, left.q, left.checks) == (1, [], {})
    assert left.why.endswith("from 1 to 2; tried from 1 other place as well")


def test_one_that_has_a_way_back_past_another_only_comes_after_that(
    planned: Callable[..., list[TargetMove]],
) -> None:
    """From 1 nothing leads straight back, and the way that it came from home is barred backwards."""
    assert numbers(planned((1, HOME))) == [2, 1, 3]
    alone = planned((1, HOME), (1, 2), (2, HOME), (3, HOME))
    assert numbers(alone) == []
    assert all(m.why.startswith("no way back from there: ") for m in alone)


def barred(patch: pytest.MonkeyPatch, cell: ObjectCell, states: set[str]) -> None:
    """In these states the way from home to where the first target brings the arm is not free."""
    genuine, home = MotionGuard.check_path_joints, np.array(cell.config.poses["home"], dtype=float)
    first: list[Array] = []

    def check(self: MotionGuard, q0: Array, q1: Array) -> None:
        genuine(self, q0, q1)
        run = cell.engine.run
        among = run is not None and "solve" in {s.value for _, s in run.visited}
        if not among or cell.state not in states or not np.allclose(q0, home, atol=1e-3):
            return
        if not first and not np.allclose(q1, home, atol=1e-3):
            first.append(np.array(q1))
        if first and np.allclose(q1, first[0]):
            raise error("MOTION_COLLISION", "a box before home")

    patch.setattr(MotionGuard, "check_path_joints", check)


@pytest.mark.parametrize("states", [{"plan", "move"}, {"move"}], ids=["planned", "met on the way"])
def test_a_target_that_is_refused_at_first_is_reached_from_another(
    states: set[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, poses=14, targets=wanted(*STEPS[:3]))) as cell:
            barred(monkeypatch, cell, states)
            run_id, asked = await driven_run(cell)
            order = "in this order: target 2 as given, target 1 as given, target 3 as given. Confirm"
            assert (order in asked) is ("plan" in states)
            driven = cell.result(run_id)["result"]["driven"]
            assert driven["lost"] == []
            assert [line["target"] for line in cell.notes(run_id, "target seen")] == [2, 1, 3]
            off = [line["target"] for line in cell.notes(run_id, "target put off")]
            assert off == ([] if "plan" in states else [1])
            assert "stands" not in driven
            home = np.array(cell.config.poses["home"], dtype=float)
            np.testing.assert_allclose(cell.plant.world.track.at(cell.clock.now())[0], home, atol=1e-3)

    run_virtual(main())


def test_a_target_that_no_way_leads_to_is_journalled_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, poses=14, targets=wanted(*STEPS[:3]))) as cell:
            genuine = MotionGuard.check_path_joints

            def check(self: MotionGuard, q0: Array, q1: Array) -> None:
                genuine(self, q0, q1)
                run = cell.engine.run
                if run is None or cell.state != "move" or not (planned := cell.notes(run.id, "targets")):
                    return
                if np.allclose(q1, planned[0]["moves"][0]["q"]):
                    raise error("MOTION_COLLISION", "a box about the first")

            monkeypatch.setattr(MotionGuard, "check_path_joints", check)
            run_id, _ = await driven_run(cell)
            (lost,) = cell.result(run_id)["result"]["driven"]["lost"]
            assert lost.startswith("target 1 as given: ")
            assert lost.endswith("a box about the first; tried from 2 other places as well")
            assert len(cell.notes(run_id, "target put off")) == 3
            (said,) = cell.notes(run_id, "target lost")
            assert lost.endswith(said["why"])
            assert cell.at_rest()

    run_virtual(main())


def test_out_of_plan_a_target_without_a_way_back_is_not_driven_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second has its way back past the first alone, and the first is refused when it is its turn."""

    async def main() -> None:
        async with check_cell(config(tmp_path, poses=14, targets=wanted(*STEPS[:2]))) as cell:
            genuine, home = MotionGuard.check_path_joints, np.array(cell.config.poses["home"], dtype=float)

            def check(self: MotionGuard, q0: Array, q1: Array) -> None:
                genuine(self, q0, q1)
                run = cell.engine.run
                if run is None or cell.state != "move" or not (planned := cell.notes(run.id, "targets")):
                    return
                one, other = (np.array(m["q"]) for m in planned[0]["moves"])
                for start, end in ((home, one), (other, home), (other, one)):
                    if np.allclose(q0, start, atol=1e-3) and np.allclose(q1, end, atol=1e-3):
                        raise error("MOTION_COLLISION", "a box that came")

            monkeypatch.setattr(MotionGuard, "check_path_joints", check)
            run_id, _ = await driven_run(cell)
            first, second = cell.result(run_id)["result"]["driven"]["lost"]
            assert first.startswith("target 1 as given: ")
            assert second.startswith("target 2 as given: no way back from there: ")
            assert cell.notes(run_id, "target seen") == []
            moved = [line["q"] for line in cell.notes(run_id, "move_joints")]
            planned = cell.notes(run_id, "targets")[0]["moves"]
            assert not any(np.allclose(q, planned[1]["q"]) for q in moved)

    run_virtual(main())
