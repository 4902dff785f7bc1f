"""Pairs of poses that easy_handeye2, MoveIt calibration and ViSP have saved, all in metres and radians.

easy_handeye2 (its ``handeye_sampler.py``): ``NAME.samples`` has ``robot`` and ``tracking`` of each sample as
translation and quaternion by name. ``tracking`` is the marker in the tracking base: ``T_camera_target``.
``robot`` is the effector in the base for ``eye_in_hand``, and the base in the effector, turned round, for
``eye_on_base``. The type may be empty in the samples; ``NAME.calib`` beside has it then.

MoveIt calibration (``handeye_control_widget.cpp``): a list, each entry with ``effector_wrt_world`` and
``object_wrt_sensor``, 16 numbers row after row; the mount of the sensor is not in the file.

ViSP (``visp-compute-eye-in-hand-calibration.cpp``): ``pose_rPe_N.yaml``, in older releases ``pose_fPe_N``, is
the effector in the robot's base, ``pose_cPo_N.yaml`` the object in the camera; each a column of three
translations and three numbers of the rotation vector.
"""

import re
from pathlib import Path
from typing import Any

from scipy.spatial.transform import RigidTransform

from cell.errors import error
from daemon.importing.files import numbers, read_yaml
from daemon.importing.pose_pairs import Imported, PosePair, Setup, chosen_setup, fault
from daemon.importing.rotations import PoseFault, matrix, quaternion, rotation_vector

_EASY: dict[str, Setup] = {"eye_in_hand": "eye-in-hand", "eye_on_base": "eye-to-hand"}
_VISP = re.compile(r"(?P<stem>.*)pose_(?P<what>[rf]Pe|cPo)_(?P<n>\d+)\.ya?ml", re.IGNORECASE)


def read_easy_handeye2(path: Path, setup: str | None) -> Imported:
    """``NAME.samples``, or a folder that holds one."""
    file = _only(path, "*.samples", "NAME.samples of easy_handeye2")
    document = _table(file, read_yaml(file))
    samples = document.get("samples")
    if not isinstance(samples, list):
        raise fault(file, "", "it has no list 'samples'; NAME.calib is a result: give NAME.samples")
    told = _type(document)
    beside = file.with_suffix(".calib")
    if told is None and beside.is_file():
        told = _type(_table(beside, read_yaml(beside)))
    chosen = chosen_setup(setup, told, file, f"{file} does not say where the camera was")
    pairs = []
    for k, sample in enumerate(samples):
        robot = _transform(file, k, sample, "robot")
        seen = _transform(file, k, sample, "tracking")
        pairs.append(PosePair(robot if chosen == "eye-in-hand" else robot.inv(), seen))
    return Imported(file, chosen, pairs)


def read_moveit(path: Path, setup: str | None) -> Imported:
    """The file that 'Save samples' of MoveIt's calibration panel wrote."""
    document = read_yaml(path)
    if isinstance(document, dict) and "joint_values" in document:
        raise fault(path, "", "it holds joint states only; 'Save samples' writes the poses")
    if not isinstance(document, list):
        raise fault(path, "", "it is no list of samples; give the file that 'Save samples' wrote")
    chosen = chosen_setup(setup, None, path, f"{path} does not say where the camera was")
    pairs = []
    for k, sample in enumerate(document):
        entry = sample if isinstance(sample, dict) else {}
        poses = []
        for key in ("effector_wrt_world", "object_wrt_sensor"):
            found = numbers(entry.get(key), 16)
            if found is None:
                raise fault(path, f"sample {k}", f"'{key}' should have 16 numbers, row after row")
            try:
                poses.append(matrix(found))
            except PoseFault as exc:
                raise fault(path, f"sample {k}, {key}", exc) from exc
        pairs.append(PosePair(poses[0], poses[1]))
    return Imported(path, chosen, pairs)


def read_visp(path: Path, setup: str | None) -> Imported:
    """A folder with ``pose_rPe_N.yaml`` and ``pose_cPo_N.yaml``; any text may stand before ``pose``."""
    if not path.is_dir():
        raise error(
            "FILE_MISSING", f"{path} is no folder; give the one with pose_rPe_1.yaml and pose_cPo_1.yaml"
        )
    flanges: dict[int, Path] = {}
    targets: dict[int, Path] = {}
    for file in sorted(path.iterdir()):
        if match := _VISP.fullmatch(file.name):
            kind = targets if match["what"].casefold() == "cpo" else flanges
            n = int(match["n"])
            if n in kind:
                raise fault(path, "", f"{kind[n].name} and {file.name} are both number {n}; keep one of them")
            kind[n] = file
    both = sorted(flanges.keys() & targets.keys())
    if not both:
        raise fault(path, "", "no pose_rPe_N.yaml (or pose_fPe_N.yaml) has its pose_cPo_N.yaml")
    chosen = chosen_setup(setup, None, path, f"{path} does not say where the camera was")
    alone = sorted(flanges.keys() ^ targets.keys())
    left = [f"{(flanges.get(n) or targets[n]).name} has no partner and was left out" for n in alone]
    pairs = [PosePair(_column(flanges[n]), _column(targets[n])) for n in both]
    return Imported(path, chosen, pairs, left)


def _only(path: Path, pattern: str, what: str) -> Path:
    if not path.is_dir():
        return path
    files = sorted(path.glob(pattern))
    if len(files) != 1:
        raise error("ARGUMENT_INVALID", f"{path} holds {len(files)} files {pattern}: give {what} itself")
    return files[0]


def _table(path: Path, document: Any) -> dict[str, Any]:
    if not isinstance(document, dict):
        raise fault(path, "", "it is no table; give the file that easy_handeye2 wrote")
    return document


def _type(document: dict[str, Any]) -> Setup | None:
    parameters = document.get("parameters")
    return _EASY.get(str(parameters.get("calibration_type"))) if isinstance(parameters, dict) else None


def _transform(path: Path, k: int, sample: Any, name: str) -> RigidTransform:
    part = sample.get(name) if isinstance(sample, dict) else None
    tables = (part.get("translation"), part.get("rotation")) if isinstance(part, dict) else (None, None)
    found = [
        numbers([table.get(axis) for axis in axes], len(axes)) if isinstance(table, dict) else None
        for table, axes in zip(tables, ("xyz", "xyzw"), strict=True)
    ]
    if found[0] is None or found[1] is None:
        raise fault(path, f"sample {k}", f"'{name}' needs translation x, y, z and rotation x, y, z, w")
    try:
        return quaternion(found[0], found[1])
    except PoseFault as exc:
        raise fault(path, f"sample {k}, {name}", exc) from exc


def _column(path: Path) -> RigidTransform:
    document = read_yaml(path)
    found = numbers(document.get("data") if isinstance(document, dict) else None, 6)
    if found is None:
        raise fault(
            path, "data", "should be six numbers: x, y, z in metres and the rotation vector in radians"
        )
    return rotation_vector(found[:3], found[3:])
