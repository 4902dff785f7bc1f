"""Captures as real cells give them, and what people get wrong in them, each with its code."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import from_pose6, to_pose6
from tests.kit.imperfect_cell import CAMERA, MODEL, WHOLE_PLANS, World, capture, capture_eye_to_hand, world

Document = dict[str, Any]
BOARD = {
    "type": "charuco",
    "squares_x": 10,
    "squares_y": 7,
    "square_m": 0.025,
    "marker_m": 0.018,
    "dictionary": "DICT_5X5_100",
}


@dataclass(frozen=True)
class Kind:
    """A mistake: its code, what it does to a good capture, and whether joints are given (None: any)."""

    code: str
    spoil: Callable[[np.random.Generator, Document], None]
    joints: bool | None = None


def good(rng: np.random.Generator, joints: bool, plan: str | None = None) -> Document:
    """A capture of a cell whose arm, lens and board are as real ones; any plan, or the one that is named."""
    cell = _world(rng)
    if plan is None and rng.integers(3) == 0:
        measured, Q, _ = capture_eye_to_hand(rng, cell)
    else:
        measured, Q = capture(rng, cell, plan or str(rng.choice(WHOLE_PLANS)))
    seen = [v.corners.tolist() if v is not None else [] for v in measured.views]
    # the kit's board has its z to the camera; a ChArUco board's points into the wall
    order = np.arange(54).reshape(6, 9)[::-1].ravel()
    document: Document = {
        "schema": "cellward.capture/1",
        "setup": measured.setup,
        "camera": asdict(CAMERA),
        "target": dict(BOARD),
        "observations": [
            {
                "index": k,
                "group": int(measured.group[k]),
                "corners": [seen[k][i] for i in order],
                "T_base_flange": to_pose6(RigidTransform.from_matrix(measured.F[k])).tolist(),
            }
            for k in range(len(seen))
        ],
    }
    if joints:
        document["robot"] = {"model": "ur10e"}
        for o, q in zip(document["observations"], Q, strict=True):
            o["q"] = q.tolist()
    return document


def _world(rng: np.random.Generator) -> World:
    arm = float(rng.choice([0.0, 0.06e-3, 0.2e-3]))
    return world(rng, arm, str(rng.choice(["exact", "off"])), str(rng.choice(["exact", "scale", "bow"])))


def _poses(change: Callable[[list[float]], list[float]]) -> Callable[[np.random.Generator, Document], None]:
    def spoil(_: np.random.Generator, document: Document) -> None:
        for o in document["observations"]:
            o["T_base_flange"] = change(o["T_base_flange"])

    return spoil


def _inverse(pose: list[float]) -> list[float]:
    return list(to_pose6(from_pose6(np.array(pose)).inv()))


def _quaternion(pose: list[float]) -> list[float]:
    x, y, z, w = Rotation.from_rotvec(pose[3:]).as_quat()
    return [*pose[:3], *Rotation.from_quat([w, x, y, z]).as_rotvec().tolist()]


def _size(rng: np.random.Generator, document: Document) -> None:
    factor = 1.0 + rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.01), np.log(0.15)))
    for key in ("square_m", "marker_m"):
        document["target"][key] *= float(factor)


def _target_millimetres(_: np.random.Generator, document: Document) -> None:
    for key in ("square_m", "marker_m"):
        document["target"][key] *= 1e3


def _arm_millimetres(_: np.random.Generator, document: Document) -> None:
    _poses(lambda p: [*(1e3 * v for v in p[:3]), *p[3:]])(_, document)


def _bent(rng: np.random.Generator, document: Document) -> None:
    """By 1 to 3 mm: new corners, as the board was."""
    bow = float(rng.uniform(1e-3, 3e-3))
    turn = rng.uniform(0, np.pi)
    grid = np.array([[0.025 * x, 0.025 * y, 0.0] for y in range(1, 7) for x in range(1, 10)])
    off = (grid - grid.mean(axis=0))[:, :2]
    across = off @ (np.cos(turn), np.sin(turn))
    bent = grid.copy()
    bent[:, 2] += bow * (across / np.abs(across).max()) ** 2
    for o in document["observations"]:
        corners = np.array(o["corners"])
        _, r, t = cv2.solvePnP(grid, corners, CAMERA.matrix, np.zeros(4))
        moved = cv2.projectPoints(bent, r, t, CAMERA.matrix, np.zeros(4))[0]
        flat = cv2.projectPoints(grid, r, t, CAMERA.matrix, np.zeros(4))[0]
        o["corners"] = (corners + (moved - flat).reshape(-1, 2)).tolist()


def _mirrored_images(_: np.random.Generator, document: Document) -> None:
    last = document["camera"]["width"] - 1.0
    for o in document["observations"]:
        o["corners"] = [[last - u, v] for u, v in o["corners"]]


def _mirrored_numbers(_: np.random.Generator, document: Document) -> None:
    order = np.arange(54).reshape(6, 9)[:, ::-1].ravel()
    for o in document["observations"]:
        o["corners"] = [o["corners"][i] for i in order]


def _tool(rng: np.random.Generator, document: Document) -> None:
    tool = from_pose6(np.array([*(rng.uniform(-0.05, 0.05, 2)), rng.uniform(0.05, 0.25), 0.0, 0.0, 0.0]))
    _poses(lambda p: list(to_pose6(from_pose6(np.array(p)) * tool)))(rng, document)


def _other_setup(_: np.random.Generator, document: Document) -> None:
    other = {"eye-in-hand": "eye-to-hand", "eye-to-hand": "eye-in-hand"}
    document["setup"] = other[document["setup"]]


def _degrees(_: np.random.Generator, document: Document) -> None:
    _poses(lambda p: [*p[:3], *np.degrees(p[3:]).tolist()])(_, document)


def _joints_in_degrees(_: np.random.Generator, document: Document) -> None:
    for o in document["observations"]:
        o["q"] = np.degrees(o["q"]).tolist()


def _order(change: Callable[[np.random.Generator, int], Any]) -> Callable[..., None]:
    def spoil(rng: np.random.Generator, document: Document) -> None:
        observations = document["observations"]
        order = change(rng, len(observations))
        keys = [key for key in ("T_base_flange", "q") if key in observations[0]]
        moved = [{key: observations[int(k)][key] for key in keys} for k in order]
        for o, own in zip(observations, moved, strict=True):
            o.update(own)

    return spoil


def _two_exchanged(rng: np.random.Generator, n: int) -> Any:
    order = np.arange(n)
    i, k = rng.choice(n, 2, replace=False)
    order[[i, k]] = order[[k, i]]
    return order


def _copies(rng: np.random.Generator, document: Document) -> None:
    observations = document["observations"]
    for k in rng.choice(len(observations), 3, replace=False):
        observations.append({**observations[int(k)], "index": len(observations)})


def _stale(rng: np.random.Generator, document: Document) -> None:
    observations = document["observations"]
    k = int(rng.integers(1, len(observations)))
    observations[k]["corners"] = observations[k - 1]["corners"]


def _zero(told: bool) -> Callable[[np.random.Generator, Document], None]:
    """A joint's zero that the camera sees; ``told``: the poses are of the joints, both are wrong."""

    def spoil(rng: np.random.Generator, document: Document) -> None:
        j = int(rng.integers(1, 5))
        offset = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.01), np.log(0.2))))
        for o in document["observations"]:
            o["q"][j] += offset
            if told:
                F = MODEL.base.flange(np.array([o["q"]]))[0]
                o["T_base_flange"] = to_pose6(RigidTransform.from_matrix(F)).tolist()

    return spoil


KINDS = {
    "square size": Kind("target.scale", _size),
    "target in mm": Kind("units.translation", _target_millimetres),
    "arm in mm": Kind("units.translation", _arm_millimetres),
    "bent board": Kind("target.flatness", _bent),
    "mirrored images": Kind("target.mirrored", _mirrored_images),
    "mirrored numbering": Kind("target.mirrored", _mirrored_numbers),
    "TCP poses": Kind("poses.tcp", _tool, joints=True),
    "inverted": Kind("poses.inverted", _poses(_inverse)),
    "other setup": Kind("poses.frames-swapped", _other_setup),
    "degrees": Kind("units.rotation", _degrees),
    "joints in degrees": Kind("units.rotation", _joints_in_degrees, joints=True),
    "quaternion order": Kind("poses.quaternion-order", _poses(_quaternion)),
    "reversed": Kind("poses.time", _order(lambda _, n: np.arange(n)[::-1])),
    "shifted": Kind("poses.time", _order(lambda rng, n: np.roll(np.arange(n), rng.choice([-2, -1, 1, 2])))),
    "shuffled": Kind("poses.time", _order(lambda rng, n: rng.permutation(n))),
    "two exchanged": Kind("poses.time", _order(_two_exchanged)),
    "copies": Kind("poses.copies", _copies),
    "stale image": Kind("poses.copies", _stale),
    "zero of q": Kind("joints.zero", _zero(told=False), joints=True),
    "zero of the arm": Kind("joints.zero", _zero(told=True), joints=True),
}
