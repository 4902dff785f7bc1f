"""The one physical world of the twin; its state is a function of time.

The controller knows the arm by its *believed* chain and reports that; cameras and trackers see the *true*
one: other links and joints where the scenario has errors, and a small deviation that is new at every
standstill. A camera tells the intrinsics of the lens that it believes to have, and pictures come from the
true one; the target is the one that was printed, and the configuration has the design of it.
"""

from bisect import bisect_right
from collections.abc import Callable
from functools import cached_property
from math import inf
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.errors import error
from cell.poses import Array, from_pose6, to_pose6
from fakes.world.arm.gauge import serving
from fakes.world.arm.kinematics import LinkDeltas, chain_of, frames_at_zero
from fakes.world.arm.repeatability import Repeatability
from fakes.world.arm.reported import Reported
from fakes.world.arm.segments import Segment
from fakes.world.arm.shape import capsule_shape, ur_shape
from fakes.world.arm.tool_motion import ToolMotion
from fakes.world.arm.tool_shape import ToolShape
from fakes.world.arm.track import Track
from fakes.world.arm.true_arm import TrueArm
from fakes.world.arm.truth import Links
from fakes.world.beams.beams import Beams
from fakes.world.beams.input_module import InputModule
from fakes.world.belt.belt import Belt
from fakes.world.belt.encoder import BeltEncoder
from fakes.world.belt.gripper import Gripper
from fakes.world.belt.items import Items
from fakes.world.belt.place import Place
from fakes.world.camera.printed import printed_target
from fakes.world.camera.truth import CameraTruth
from fakes.world.hand_guided import JOG_RAD_S, JOG_RAD_S2, joints_over
from fakes.world.palletizer.observed import ObservedPalletizer
from fakes.world.rack.rack import Rack
from fakes.world.scenario import Scenario, WorldTruth
from fakes.world.scene import Scene
from fakes.world.targets import target_points
from fakes.world.tracker.tracker import Tracker

_TRACKER_LOOKS_S = 1.0  # a set-point stream has a segment every few milliseconds
_TOLD_OF_CAMERA = {"serial", "width", "height", "K", "dist", "stamp_late_s"}
Message = tuple[Any, ...]  # what keeps a mirror in step; picklable


class Operator:
    """The person who puts the target where the job wants it; a change is an event in time."""

    def __init__(self, t: float, placements: int) -> None:
        self.placements = placements
        self.listeners: list[Callable[[float, int | None], None]] = []
        self._times, self._where = [t], [0 if placements else None]

    def confirm(self, placement: int, t: float) -> None:
        """From ``t`` on the target is at ``placement`` (counted from 0)."""
        if not 0 <= placement < self.placements:
            raise ValueError(f"placement {placement} does not exist, the scenario has {self.placements}")
        self._put(placement, t)

    def move_on(self, t: float) -> int:
        """Put the target at the next placement, after the last one at the first; returns its number."""
        last = next((p for p in reversed(self._where) if p is not None), -1)
        self.confirm((last + 1) % self.placements, t)
        return (last + 1) % self.placements

    def remove(self, t: float) -> None:
        """Take the target out of the cell at ``t``."""
        self._put(None, t)

    def put_back(self, t: float) -> None:
        """Put the target back where it was last."""
        self._put(next((p for p in reversed(self._where) if p is not None), 0), t)

    def placement_at(self, t: float) -> int | None:
        """Where the target is at ``t``, or None."""
        return self._where[max(bisect_right(self._times, t) - 1, 0)]

    def history(self) -> list[tuple[float, int | None]]:
        """All changes, oldest first."""
        return list(zip(self._times, self._where, strict=True))

    def load(self, history: list[tuple[float, int | None]]) -> None:
        """Become a copy of the operator whose :meth:`history` this is."""
        self._times, self._where = [t for t, _ in history], [where for _, where in history]

    def follow(self, t: float, placement: int | None) -> None:
        """Do at ``t`` what the operator of the mirrored world did."""
        self._put(placement, t)

    def _put(self, placement: int | None, t: float) -> None:
        keep = max(bisect_right(self._times, t), 1)
        self._times[keep:], self._where[keep:] = [t], [placement]
        for listener in tuple(self.listeners):
            listener(t, placement)


class World:
    """Arm, tool, beams, camera, target and obstacles as they truly are."""

    def __init__(self, truth: WorldTruth, t0: float) -> None:
        self.config, self.t0 = truth, t0
        self.believed = chain_of(*truth.arm.drawing(truth.arm.factory.deltas()))
        self.true = TrueArm.of(truth.arm, truth.seed)
        robot = truth.arm.serial6()
        if robot is None:
            self.shape = ur_shape(truth.arm.model, self.true)
        else:
            at_zero = frames_at_zero(*truth.arm.drawing(LinkDeltas()))
            self.shape = capsule_shape(robot, at_zero, self.true)
        self.track = Track(t0, truth.arm.q_start)
        self.reported = Reported(truth.arm.reported, truth.seed)
        self.T_flange_tool = from_pose6(truth.tool.T_flange_tool)  # nominal
        self.tool = ToolShape(t0, truth.tool)
        self.target = truth.target or {}
        self.printed = printed_target(truth.target_print, self.target)
        self.eye_in_hand = truth.eye_in_hand
        if truth.camera is not None:
            self.intrinsics, self.told_intrinsics = truth.camera.true_lens(), truth.camera.told_lens()
            self.T_mount_camera = from_pose6(truth.camera_mount)
        self.T_mount_target = [from_pose6(pose) for pose in truth.target_mounts]
        self.operator = Operator(t0, len(self.T_mount_target))
        self._repeatability = Repeatability(
            truth.seed, truth.arm.repeatability_t_m, truth.arm.repeatability_r_rad
        )
        self.track.listeners.append(self._repeatability.add)
        self.beams = Beams(truth.beams, self._tool_motion(), self.tool.radii, t0)
        if truth.beams:
            self.track.listeners.append(self.beams.on_segment)
            self.tool.listeners.append(lambda bend: self.beams.on_change(bend[0]))
        self.observed = None if truth.observed is None else ObservedPalletizer(truth.observed, truth.seed, t0)
        self.belt: Belt | None = None
        self.encoder: BeltEncoder | None = None
        if truth.belt is not None:
            self.belt = Belt(truth.belt, truth.seed, t0)
            self.encoder = BeltEncoder(truth.belt, self.belt, t0)
        self.items: Items | None = None
        if truth.items is not None and self.belt is not None:
            self.items = Items(truth.items, self.belt, truth.seed)
        self.rack = None if truth.rack is None else Rack(truth.rack, self.true_matrix, t0)
        self.gripper: Gripper | None = None
        if truth.gripper is not None:
            self.gripper = Gripper(truth.gripper, self.items or self.rack, self.tool_point)
        self.place: Place | None = None
        if truth.place is not None and self.gripper is not None:
            self.place = Place(truth.place, self.gripper, self.tool_point, t0)
        self.inputs = None if truth.io is None else InputModule(truth.io, self.beams, t0)
        self.tracker: Tracker | None = None
        if (tracker := truth.tracker) is not None:
            seed, reflectors = truth.seed, truth.reflectors
            arm = "arm" if self.observed is None else "observed"
            self.tracker = Tracker(
                tracker, reflectors, self.carrier, self.stands_still, seed, t0, self._links, arm
            )
            self.track.listeners.append(self._tracker_looks)
            self._tracker_looks_until = t0
            if self.observed is not None:
                self.observed.listeners.append(self.tracker.advance)

    @classmethod
    def from_scenario(cls, scenario: Scenario, t0: float = 0.0) -> "World":
        """The world of ``scenario`` as it stands at ``t0`` seconds on the twin's clock."""
        return cls(scenario.world, t0)

    def mirror_to(self, send: Callable[[Message], None]) -> None:
        """Hand ``send`` the state and then every change; by :meth:`apply` another world follows."""
        segments = self.track.snapshot()
        blends, bends = self._repeatability.history(), self.tool.history()
        beams = self.beams.snapshot(segments[0].t0)
        send(("state", segments, blends, self.operator.history(), bends, beams))
        if self.belt is not None:
            send(("belt", self.belt.begin, self.belt.orders()))
            self.belt.listeners.append(lambda order: send(("belt-order", order)))
        if self.items is not None:
            send(("items", self.items.taken()))
            self.items.listeners.append(lambda number, t: send(("taken", number, t)))
        if self.rack is not None:
            send(("rack", self.rack.places()))
            self.rack.listeners.append(lambda number, place: send(("part", number, place)))
        self.track.listeners.append(lambda segment: send(("segment", segment)))
        self.operator.listeners.append(lambda t, placement: send(("placement", t, placement)))
        self.tool.listeners.append(lambda bend: send(("bend", bend)))

    def apply(self, message: Message) -> None:
        """Follow one message of another world's :meth:`mirror_to`."""
        match message:
            case ("segment", segment):
                self.track.append(segment)
            case ("placement", t, placement):
                self.operator.follow(t, placement)
            case ("belt", begin, orders) if self.belt is not None:
                self.belt.load(begin, orders)
            case ("belt-order", order) if self.belt is not None:
                self.belt.follow(order)
            case ("items", taken) if self.items is not None:
                self.items.load(taken)
            case ("taken", number, t) if self.items is not None:
                self.items.take(number, t)
            case ("rack", places) if self.rack is not None:
                self.rack.load(places)
            case ("part", number, place) if self.rack is not None:
                self.rack.follow(number, place)
            case ("bend", bend):
                self.tool.follow(bend)
            case ("state", segments, blends, history, bends, beams):
                self.track.load(segments)
                self._repeatability.load(blends)
                self.operator.load(history)
                self.tool.load(bends)
                self.beams.load(beams, self._tool_motion())
            case _:
                raise ValueError(f"a world does not know the message {message[0]!r}")

    def believed_flange(self, t: float) -> RigidTransform:
        """``T_base_flange`` as the controller computes it."""
        return self.believed.forward(self.track.at(t)[0])

    def true_flange(self, t: float) -> RigidTransform:
        """``T_base_flange`` as it truly is."""
        return RigidTransform(self.true_matrix(t), normalize=False, copy=False)

    def true_matrix(self, t: float) -> Array:
        """The same as (4, 4), in a third of the time: what a beam or a tracker meets asks at every look."""
        out: Array = self.true.matrix(self.track.at(t)[0]) @ self._repeatability.matrix(t)
        return out

    def carrier(self, on: str, t: float) -> Array:
        """Where in the base that truly is which a reflector may be ``on``: arm or base; (4, 4)."""
        match on:
            case "arm":
                return self.true_matrix(t)
            case "base":
                return np.eye(4)
            case "observed" if self.observed is not None:
                return self.observed.true_matrix(t)
            case _:
                raise error("CONFIG_INVALID", f"the scenario has no {on} arm that could carry a reflector")

    def stands_still(self, on: str, t: float) -> bool:
        """Whether what a reflector may be ``on`` does not move from ``t`` on, as far as is planned."""
        track = self.observed.track if on == "observed" and self.observed is not None else self.track
        return on == "base" or not track.is_moving(t)

    def _links(self, t: float) -> Array:
        """Of the arm that a tracker is there for: a UR beside an observed arm is parked out of the way."""
        if self.observed is not None:
            return self.observed.lines(t)
        return self.shape.lines(self.track.at(t)[0])

    def _tracker_looks(self, segment: Segment) -> None:
        """Before the track forgets it: what the arm did until the segment before this one began.

        Not until this one: it may lie in the future, behind a braking that may yet be replaced.
        """
        until = self._tracker_looks_until
        if self.tracker is not None and until > self.tracker.seen + _TRACKER_LOOKS_S:
            self.tracker.advance(until)
        self._tracker_looks_until = segment.t0

    def tool_point(self, t: float) -> Array:
        """(3,) the true tool's point in the base."""
        return self._carried(t, self.T_flange_tool_at(t).translation)

    def _carried(self, t: float, p_flange: Array) -> Array:
        """(3,) a point of the flange in the base."""
        flange = self.true_matrix(t)
        point: Array = flange[:3, :3] @ p_flange + flange[:3, 3]
        return point

    def bring_over(self, t: float, point: int, gauge_m: float, hand_m: float) -> float:
        """A person jogs the tool's point over ``point`` of the target, a gauge of ``gauge_m`` between and
        ``hand_m`` (one standard deviation of an axis) beside it; returns when the arm rests there.

        ``CONFIG_INVALID`` when the scenario has no target in the base, or none with such a point.
        """
        placement = self.operator.placement_at(t)
        points = target_points(self.target) if self.target else np.zeros((0, 3))
        if placement is None or not self.eye_in_hand or not 0 <= point < len(points):
            raise error("CONFIG_INVALID", f"the scenario has no target in the base with a point {point}")
        board = self.T_mount_target[placement]
        q = self.track.at(t)[0]
        side = np.sign(board.inv().apply(self.true.forward(q).translation)[2])
        off = hand_m * np.random.default_rng([self.config.seed, point]).standard_normal(3)
        over = self.printed.placed(points[[point]])[0] + off + np.array([0.0, 0.0, side * gauge_m])
        tool = self.T_flange_tool_at(t).translation
        q = joints_over(self.true, self.believed, tool, board.apply(over), q)
        return self.track.start_joint_move(t, q, JOG_RAD_S, JOG_RAD_S2)

    def T_flange_tool_at(self, t: float) -> RigidTransform:
        """``T_flange_tool`` as it truly is, bent or not."""
        return self.tool.T_flange_tool_at(t)

    def arm_digital_in(self, t: float) -> int:
        """The arm's own digital inputs as a word; bits are on while a beam is broken or the gripper holds."""
        wired = self.config.arm_inputs.items()
        word = sum(self.beams.level(name, t) << bit for name, bit in wired)
        confirm = None if self.gripper is None else self.gripper.truth.confirm
        if confirm is not None and self.gripper is not None and self.gripper.holds(t) is not None:
            word |= 1 << confirm
        return word

    def set_arm_output(self, t: float, word: int) -> None:
        """The arm's digital outputs are ``word`` from ``t`` on."""
        if self.gripper is None:
            return
        truth = self.gripper.truth
        close = bool(word >> truth.output & 1)
        if truth.open_output is None or close is not bool(word >> truth.open_output & 1):
            self.gripper.command(t, close)

    @property
    def camera(self) -> CameraTruth:
        """The camera; ``CONFIG_INVALID`` when the scenario has none."""
        if self.config.camera is None:
            raise error("CONFIG_INVALID", "the scenario has no [world.camera]")
        return self.config.camera

    def _tool_motion(self) -> ToolMotion:
        return ToolMotion(self.true, self._repeatability, self.tool, self.track.snapshot())

    def scene(self, t: float) -> Scene:
        """The true poses at ``t``."""
        placement = self.operator.placement_at(t)
        target = None if placement is None else self.T_mount_target[placement]
        return Scene(t, placement, self.true_matrix(t), self.T_mount_camera, target, self.eye_in_hand)

    def contact_force(self, t: float, T_flange_tcp: RigidTransform) -> Array:
        """Force (N) of obstacles on the true tool's tip, and of a rack on the part that is held, and their
        moment (Nm) about the TCP, (6,), in the base."""
        force = np.zeros(6)
        if self.rack is not None:
            force[:3], at = self.rack.force(t)
            if force.any():
                force[3:] = np.cross(at - self._carried(t, T_flange_tcp.translation), force[:3])
        if self.config.obstacle:
            tip = self.tool_point(t)
            pushed = sum((obstacle.push(tip) for obstacle in self.config.obstacle), np.zeros(3))
            force[:3] += pushed
            force[3:] += np.cross(tip - self._carried(t, T_flange_tcp.translation), pushed)
        return force

    def truth(self, t: float = inf) -> dict[str, Any]:
        """Everything a result may be judged against at ``t``, as plain JSON values.

        Poses of the camera and the target are those that serve best with the arm as its *controller* has it,
        over all joints: what a calibration with that arm can find at best. Where something really sits on
        the true arm is under ``mechanical``; without errors of links and joints both are the same. All else
        is what is mechanically so.
        """
        return {
            "schema": "cellward.truth/1",
            **self._camera_truth(),
            "T_flange_tool": to_pose6(self.T_flange_tool_at(t)).tolist(),
            "T_flange_tool_nominal": to_pose6(self.T_flange_tool).tolist(),
            "tool_shape": [c.model_dump(by_alias=True) for c in self.config.tool.shape],
            "beams": {name: beam.model_dump() for name, beam in self.config.beams.items()},
            **(
                {}
                if (io := self.config.io) is None
                else {"io": io.model_dump(include={"filter_s", "scan_s"})}
            ),
            **({} if self.tracker is None else {"tracker": self.tracker.told(t)}),
            **self._belt_truth(t),
            **({} if self.rack is None or t == inf else {"rack": self.rack.truth_at(t)}),
            "robot": {
                "model": self.config.arm.name,
                "serial": self.config.arm.serial,
                "factory": self.config.arm.factory.model_dump(),
                "error": self.config.arm.error.model_dump(),
                "joint_errors": [] if self.true.errors is None else self.true.errors.told(),
                "stamp_late_s": self.reported.late_s,
            },
            **({} if self.observed is None else {"observed": self.observed.report(t)}),
            "noise": {
                **({"sigma_px": self.config.camera.noise_px} if self.config.camera is not None else {}),
                "sigma_flange_t": self.config.arm.repeatability_t_m,
                "sigma_flange_r": self.config.arm.repeatability_r_rad,
            },
        }

    def _belt_truth(self, t: float) -> dict[str, Any]:
        if self.belt is None:
            return {}
        known = {"serial", "node", "m_per_count", "modulus", "period_s", "origin", "late_s", "jitter_s"}
        now = {} if t == inf else {"travel_m": self.belt.travel_at(t), "speed_m_s": self.belt.speed_at(t)}
        of_belt = self.belt.truth.model_dump(include=known) | {"dir": self.belt.direction.tolist(), **now}
        picking = {} if self.gripper is None or t == inf else {"gripper": self.gripper.truth_at(t)}
        return {"belt": of_belt, **picking}

    def _camera_truth(self) -> dict[str, Any]:
        if self.config.camera is None:
            return {}
        camera, target = (
            ("T_flange_camera", "T_base_target") if self.eye_in_hand else ("T_base_camera", "T_flange_target")
        )
        base, flange = self._gauge
        serving_camera, serving_target = (flange, base) if self.eye_in_hand else (base, flange)
        return {
            "setup": "eye-in-hand" if self.eye_in_hand else "eye-to-hand",
            camera: to_pose6(serving_camera * self.T_mount_camera).tolist(),
            target: [to_pose6(serving_target * T).tolist() for T in self.T_mount_target],
            "mechanical": {
                camera: to_pose6(self.T_mount_camera).tolist(),
                target: [to_pose6(T).tolist() for T in self.T_mount_target],
            },
            "camera": self.config.camera.model_dump(include=_TOLD_OF_CAMERA)
            | {"told": {"K": list(self.told_intrinsics.K), "dist": list(self.told_intrinsics.dist)}},
            "target": self.target,
            "target_print": self.config.target_print.model_dump(),
        }

    @cached_property
    def _gauge(self) -> tuple[RigidTransform, RigidTransform]:
        """By what a pose in the base, and one on the flange, stands elsewhere for the controller's arm."""
        if self.true.errors is None and self.config.arm.error == Links():
            return RigidTransform.identity(), RigidTransform.identity()
        base, flange = serving(self.believed, self.true, self.config.arm.ranges())
        return base.inv(), flange
