"""Light beams in the twin are the same however and whenever somebody looks."""

import pickle
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from cell.poses import log_xi, to_pose6
from fakes.world.beams.beams import Beams
from fakes.world.world import Message, World
from tests.kit.beam_scene import ARM, OVER, Q0, TOOL, beam, shift, world


def test_a_reader_that_polls_through_changing_plans_sees_what_one_who_comes_later_sees() -> None:
    def scene(poll_s: float) -> tuple[World, list[int]]:
        rng = np.random.default_rng(1)
        subject = world(
            1e-5,
            xs=beam([0.0, 0.004, 0.004], [1, 0.1, 0.1], latency_s=0.002, hysteresis_m=5e-5),
            ys=beam([0.002, 0.0, 0.002], [0.2, 1.0, -0.3], latency_s=0.001),
        )
        seen = []
        for k in range(150):
            t = 0.002 * k
            if k < 125:
                goal = OVER.translation + 0.008 * np.array(
                    [np.sin(40 * t), np.sin(52 * t), 0.3 * rng.normal()]
                )
                aim = RigidTransform.from_components(goal, OVER.rotation) * TOOL.inv()
                subject.track.servo(t, ARM.inverse(aim, subject.track.at(t)[0]), 0.002)
            if poll_s and k % round(poll_s / 0.002) == 0:
                seen.append(subject.beams.index("xs", t + 0.0015))
        return subject, seen

    never, _ = scene(0.0)
    for poll_s in (0.002, 0.02):
        polled, seen = scene(poll_s)
        assert seen == sorted(seen)
        for name in ("xs", "ys"):
            expected = never.beams.edges(name, -1.0, 1.0)
            found = polled.beams.edges(name, -1.0, 1.0)
            assert len(expected) > 4
            assert [b for _, b in found] == [b for _, b in expected]
            assert [t for t, _ in found] == pytest.approx([t for t, _ in expected], abs=1e-8)


def test_what_was_foreseen_is_forgotten_when_the_arm_is_stopped_before() -> None:
    subject = world(xs=beam([0.0, 0.02, 0.01], [1, 0, 0]))
    shift(subject, 0.0, [0.0, 0.04, 0.0], 0.05)
    (on, _), _ = subject.beams.edges("xs", 0.0, 5.0)
    version = subject.beams.version
    subject.track.stop_joint(on - 0.2, 5.0)
    assert subject.beams.edges("xs", 0.0, 5.0) == []
    assert subject.beams.version > version


def test_counters_are_right_though_nobody_has_asked_for_long() -> None:
    """The track forgets after ten seconds; 400 moves and an hour later every crossing is counted."""
    subject = world(xs=beam([0.0, 0.004, 0.01], [1, 0, 0], hysteresis_m=1e-5))
    there = ARM.inverse(RigidTransform.from_translation([0.0, 0.008, 0.0]) * OVER * TOOL.inv(), Q0)
    t = 0.0
    for k in range(400):
        t = subject.track.start_joint_move(t, there if k % 2 == 0 else Q0, 1.0, 20.0) + 0.1
    assert subject.beams.count("xs", t + 3600.0) == 400


def test_a_reader_of_a_tool_far_away_costs_nearly_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    subject = world(xs=beam([0.0, 0.3, 0.0], [1, 0, 0]), ys=beam([0.4, 0.0, 0.0], [0, 1, 0]))
    looks: list[int] = []
    judge = Beams._gaps

    def counted(self: Beams, piece: Any, times: np.ndarray) -> np.ndarray:
        looks.append(len(times))
        return judge(self, piece, times)

    monkeypatch.setattr(Beams, "_gaps", counted)
    for k in range(1000):
        t = 0.002 * k
        subject.track.servo(t, Q0 + 0.02 * np.sin(5.0 * t), 0.002)
        subject.beams.level("xs", t)
    assert sum(looks) < 20
    looks.clear()
    for k in range(1000):  # at rest
        subject.beams.level("ys", 10.0 + 0.005 * k)
    assert len(looks) <= 3


def test_a_mirror_sees_the_same_edges_whenever_it_begins() -> None:
    subject = world(1e-5, xs=beam([0.0, 0.01, 0.01], [1, 0, 0], hysteresis_m=5e-5, latency_s=0.001))
    early, late = (
        world(1e-5, xs=beam([0.0, 0.01, 0.01], [1, 0, 0], hysteresis_m=5e-5, latency_s=0.001))
        for _ in range(2)
    )

    def follow(mirror: World) -> None:
        def send(message: Message) -> None:
            mirror.apply(pickle.loads(pickle.dumps(message)))

        subject.mirror_to(send)

    follow(early)
    t = 0.0
    for k in range(8):
        if k == 4:
            follow(late)
        t = shift(subject, t, [0.0, 0.02 if k % 2 == 0 else -0.02, 0.0], 0.05)
        if k == 5:
            subject.tool.bend(t, [1e-4, 2e-4, 0.0], [0.005, 0.0, 0.0])
        subject.track.hold(t)
    assert subject.beams.count("xs", t) == 8
    for mirror in (early, late):
        assert mirror.beams.count("xs", t) == 8
        ours, theirs = (w.beams.edges("xs", 0.0, t) for w in (subject, mirror))
        assert [b for _, b in theirs] == [b for _, b in ours]
        assert [e for e, _ in theirs] == pytest.approx([e for e, _ in ours], abs=1e-8)
        assert np.allclose(to_pose6(mirror.T_flange_tool_at(t)), to_pose6(subject.T_flange_tool_at(t)))


def test_the_flange_does_not_leap_when_a_stop_cuts_a_move_short() -> None:
    subject = world(2e-5)
    end = subject.track.start_joint_move(0.0, Q0 + 0.1, 0.5, 1.0)
    cut = 0.4 * end
    before = log_xi(subject.believed_flange(cut - 1e-9).inv() * subject.true_flange(cut - 1e-9))
    subject.track.stop_joint(cut, 8.0)
    after = log_xi(subject.believed_flange(cut).inv() * subject.true_flange(cut))
    assert np.allclose(before, after, atol=1e-12)
    assert np.linalg.norm(before[:3]) > 1e-7
