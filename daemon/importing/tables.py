"""Pairs of poses in CSV and in plain JSON, in the convention that their columns or keys name.

A CSV file has one row a pose and a head of names. ``flange_x``, ``flange_y``, ``flange_z`` and ``target_x``
and so on are places; beside them stands one of

* ``flange_qx``, ``flange_qy``, ``flange_qz``, ``flange_qw``: unit quaternion,
* ``flange_rx``, ``flange_ry``, ``flange_rz``: rotation vector, or Euler angles in the order of ``--euler``,
* ``flange_m00`` to ``flange_m23`` (or ``m33``): the matrix, its last column being the place.

JSON is ``{"samples": [{"flange": POSE, "target": POSE}, ...]}``; a POSE is ``{"matrix": [...]}``, or has
``translation`` and one of ``quaternion_xyzw``, ``quaternion_wxyz``, ``rotation_vector`` and ``euler``.
"""

import csv
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import hypot, isfinite, pi
from pathlib import Path
from typing import Any

from scipy.spatial.transform import RigidTransform

from cell.errors import present
from cell.formats.reading import read_json
from daemon.importing.files import numbers, read_text
from daemon.importing.pose_pairs import Imported, PosePair, chosen_setup, fault
from daemon.importing.rotations import PoseFault, euler, euler_order, matrix, quaternion, rotation_vector

_MOST_RAD = 2.0 * pi + 1e-3  # an angle that was rounded, or counted once around
_FARTHEST_M = 20.0  # no flange is that far from its base
_CELLS = [f"m{row}{column}" for row in range(4) for column in range(4)]


@dataclass(frozen=True)
class Convention:
    """What numbers mean beyond their names: metres and radians of one unit, order of the angles."""

    length: float = 1.0
    angle: float = 1.0
    euler: str | None = None

    def turned(self, translation: list[float], three: list[float]) -> RigidTransform:
        """A pose of three numbers of rotation: a vector, or angles when an order was named."""
        place = [v * self.length for v in translation]
        if self.euler is None:
            return self.by_vector(place, three)
        return euler(place, self._angles(three, max(map(abs, three))), euler_order(self.euler))

    def by_vector(self, place: list[float], vector: list[float]) -> RigidTransform:
        """A pose of a place in metres and a rotation vector; angles in degrees are not read as radians."""
        return rotation_vector(place, self._angles(vector, hypot(*vector)))

    def _angles(self, numbers: list[float], largest: float) -> list[float]:
        if self.angle == 1.0 and largest > _MOST_RAD:
            raise PoseFault(f"an angle of {largest:.4g} is more than one turn in radians: give --angle deg")
        return [v * self.angle for v in numbers]

    def flange(self, pose: RigidTransform) -> RigidTransform:
        """``pose`` when a flange can be there; millimetres are not read as metres."""
        far = hypot(*pose.translation)
        if self.length == 1.0 and far > _FARTHEST_M:
            raise PoseFault(f"the flange would be {far:.4g} m from the base: give --length mm")
        return pose


def read_csv(path: Path, setup: str | None, convention: Convention) -> Imported:
    """One row a pose; comma, semicolon or tab between the columns, and a point in the numbers."""
    chosen = chosen_setup(setup, None, path, f"{path} does not say where the camera was")
    text = read_text(path)
    head = text.partition("\n")[0]
    separator = max(",;\t", key=head.count)
    rows = csv.DictReader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
    names = [name.strip() for name in rows.fieldnames or []]
    rows.fieldnames = names
    if twice := [name for name in names if names.count(name) > 1]:
        raise fault(path, "line 1", f"the column '{twice[0]}' stands there twice")
    flange, target = (_columns(path, names, part, convention) for part in ("flange", "target"))
    joints = [name for name in names if name[:1] == "q" and name[1:].isdigit()]
    pairs = []
    for row in rows:
        values = _row_numbers(path, rows.line_num, row)
        try:
            poses = convention.flange(flange(values)), target(values)
        except PoseFault as exc:
            raise fault(path, f"line {rows.line_num}", exc) from exc
        q = tuple(values[name] * convention.angle for name in sorted(joints, key=lambda n: int(n[1:])))
        pairs.append(PosePair(poses[0], poses[1], group=int(values.get("group", 0)), q=q))
    return Imported(path, chosen, pairs)


def read_plain_json(path: Path, setup: str | None, convention: Convention) -> Imported:
    """The samples of a JSON file; its ``setup`` may stand beside them."""
    document = read_json(path)
    samples = document.get("samples")
    if not isinstance(samples, list):
        raise fault(path, "", "it has no list 'samples' of flange and target")
    told = document.get("setup")
    chosen = chosen_setup(
        setup or (str(told) if told is not None else None), None, path, f"{path} has no 'setup'"
    )
    pairs = []
    for k, sample in enumerate(samples):
        poses = []
        for part in ("flange", "target"):
            pose = sample.get(part) if isinstance(sample, dict) else None
            if not isinstance(pose, dict):
                raise fault(path, f"samples[{k}].{part}", "is missing; it is a table with the pose")
            try:
                read = _pose(pose, convention)
                poses.append(convention.flange(read) if part == "flange" else read)
            except PoseFault as exc:
                raise fault(path, f"samples[{k}].{part}", exc) from exc
        group = sample.get("group", 0)
        if not isinstance(group, int):
            raise fault(path, f"samples[{k}].group", "is a whole number, one for each place of the target")
        pairs.append(PosePair(poses[0], poses[1], group=group))
    return Imported(path, chosen, pairs)


def _columns(
    path: Path, names: list[str], part: str, convention: Convention
) -> Callable[[Mapping[str, float]], RigidTransform]:
    """How the pose of ``part`` is made of a row, told by the names of the columns."""

    def have(keys: list[str]) -> list[str] | None:
        full = [f"{part}_{key}" for key in keys]
        return full if set(full) <= set(names) else None

    cells = have(_CELLS) or have(_CELLS[:12])
    place, four, three = have(["x", "y", "z"]), have(["qx", "qy", "qz", "qw"]), have(["rx", "ry", "rz"])
    ways = [way for way in (cells, place and four, place and three) if way]
    if len(ways) != 1:
        wanted = f"{part}_x, {part}_y, {part}_z with {part}_qx..qw or {part}_rx..rz, or {part}_m00..m23"
        raise fault(
            path, "line 1", f"the pose of the {part} needs one of: {wanted}; found {', '.join(names)}"
        )
    if cells:
        return lambda row: matrix([row[c] for c in cells], convention.length)
    xyz = present(place, "place")
    if four:
        return lambda row: quaternion([row[c] * convention.length for c in xyz], [row[c] for c in four])
    turn = present(three, "rotation")
    return lambda row: convention.turned([row[c] for c in xyz], [row[c] for c in turn])


def _row_numbers(path: Path, line: int, row: Mapping[str | None, Any]) -> dict[str, float]:
    if None in row or None in row.values():
        raise fault(path, f"line {line}", "it has not as many columns as the first line")
    values = {}
    for name, text in row.items():
        try:
            values[str(name)] = float(text)
        except ValueError:
            raise fault(path, f"line {line}, column {name}", f"'{text}' is no number") from None
        if not isfinite(values[str(name)]):
            raise fault(path, f"line {line}, column {name}", f"'{text}' is no finite number")
    return values


def _pose(pose: Mapping[str, Any], convention: Convention) -> RigidTransform:
    if "matrix" in pose:
        found = numbers(pose["matrix"], 16) or numbers(pose["matrix"], 12)
        if found is None:
            raise PoseFault("'matrix' has four rows of four numbers")
        return matrix(found, convention.length)
    place = numbers(pose.get("translation"), 3)
    if place is None:
        raise PoseFault("'translation' has three numbers")
    metres = [v * convention.length for v in place]
    counts = {"quaternion_xyzw": 4, "quaternion_wxyz": 4, "rotation_vector": 3, "euler": 3}
    given = [key for key in counts if key in pose]
    if len(given) != 1:
        raise PoseFault(f"give one of {', '.join(counts)}, or 'matrix'")
    key = given[0]
    found = numbers(pose[key], counts[key])
    if found is None:
        raise PoseFault(f"'{key}' has {counts[key]} numbers")
    if key == "quaternion_xyzw":
        return quaternion(metres, found)
    if key == "quaternion_wxyz":
        return quaternion(metres, [*found[1:], found[0]])
    if key == "rotation_vector":
        return convention.by_vector(metres, found)
    if convention.euler is None:
        raise PoseFault("'euler' is there: name the order of the angles with --euler, as in --euler kuka-abc")
    return convention.turned(place, found)
