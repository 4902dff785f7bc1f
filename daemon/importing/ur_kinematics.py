"""A UR arm's factory calibration, from a file of its controller, as a ROBOT.

An installation and a program of PolyScope 3 and 5 are gzipped XML. Their element ``kinematics`` holds
``deltaTheta``, ``a``, ``d`` and ``alpha`` of six joints, radians and metres; the last three are the whole
lengths, from which the published ones are taken off here. ``calibration.conf`` of the controller holds the
differences under ``delta_theta``, ``delta_a``, ``delta_d`` and ``delta_alpha``.
"""

import re
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from calibration.kinematics.ur import DhDeltas, UrArmModel
from calibration.kinematics.ur_models import ALPHA, UR_MODELS
from cell.errors import error
from cell.formats.robot import parse_robot
from cell.poses import Array
from daemon.importing.files import MAX_BYTES, read_bytes
from daemon.importing.pose_pairs import fault

_PARTS = ("delta_theta", "delta_a", "delta_d", "delta_alpha")
_GZIP = b"\x1f\x8b"
_NEAR_M = 0.02  # a factory calibration moves the flange by less, and the models differ by more
_TRIED = np.array(
    [[0.0, -1.2, 1.4, -1.7, -1.5, 0.0], [1.0, -0.6, 0.7, -1.0, 1.2, 0.5], [2.0, -2.0, -1.2, 0.4, 0.3, -1.0]]
)


def read_ur(path: Path, model: str | None) -> dict[str, Any]:
    """The ROBOT of an ``.installation``, an ``.urp`` or a ``calibration.conf``; ``model`` as in ``ur10e``."""
    if model is not None and model not in UR_MODELS:
        raise error("ARGUMENT_INVALID", f"--model {model}: there is {', '.join(sorted(UR_MODELS))}")
    data = _unpacked(path, read_bytes(path))
    if data.lstrip()[:1] == b"<":
        name, deltas = _from_xml(path, data, model)
    else:
        name, deltas = _from_conf(path, data, model)
    robot = {
        "model": name,
        "calibration": {key: [float(v) for v in deltas[key]] for key in _PARTS},
        "notes": {"imported_from": path.name},
    }
    parse_robot(robot, str(path))
    return robot


def _unpacked(path: Path, data: bytes) -> bytes:
    if not data.startswith(_GZIP):
        return data
    unpack = zlib.decompressobj(16 + zlib.MAX_WBITS)
    try:
        text = unpack.decompress(data, MAX_BYTES)
    except zlib.error as exc:
        raise error("FILE_UNREADABLE", f"{path} is damaged: {exc}; copy it from the robot again") from exc
    if unpack.unconsumed_tail:
        raise error("FILE_UNREADABLE", f"{path} unpacks to more than {MAX_BYTES} bytes")
    if not unpack.eof:
        raise error("FILE_UNREADABLE", f"{path} is cut short; copy it from the robot again")
    return text


def _from_xml(path: Path, data: bytes, model: str | None) -> tuple[str, dict[str, Array]]:
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise error("FILE_UNREADABLE", f"{path} declares entities, which no file of the robot does")
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as exc:
        raise error("FILE_UNREADABLE", f"{path} is not XML: {exc}; copy it from the robot again") from exc
    elements = [e for e in root.iter() if e.tag.casefold() == "kinematics"]
    known = [e for e in elements if e.get("status", "").upper() != "NOT_INITIALIZED"]
    if not elements or not known:
        why = (
            "it has no element 'kinematics'"
            if not elements
            else "it was saved without a robot (NOT_INITIALIZED)"
        )
        raise fault(path, "", f"{why}: give an .urp that was saved on the robot, or its calibration.conf")
    found = [{tag: _six(path, e, tag) for tag in ("deltaTheta", "a", "d", "alpha")} for e in known]
    if any(not np.allclose(one[tag], found[0][tag], atol=1e-9) for one in found[1:] for tag in one):
        raise fault(path, "kinematics", "the file holds those of several robots; save it anew on this one")
    of = found[0]
    fits = [name for name in UR_MODELS if _off(name, _deltas(of, name)) < _NEAR_M]
    if model is None and len(fits) == 1:
        model = fits[0]
    if model is None:
        which = f"it may be {' or '.join(fits)}" if fits else "no known model has its lengths"
        raise error("ARGUMENT_INVALID", f"{path}: {which}: give --model")
    if model not in fits:
        raise fault(
            path, "kinematics", f"it is not that of a {model}, rather of {' or '.join(fits) or 'none known'}"
        )
    return model, _deltas(of, model)


def _deltas(of: Mapping[str, Array], model: str) -> dict[str, Array]:
    nominal = UR_MODELS[model]
    return {
        "delta_theta": of["deltaTheta"],
        "delta_a": of["a"] - nominal.a,
        "delta_d": of["d"] - nominal.d,
        "delta_alpha": of["alpha"] - ALPHA,
    }


def _off(model: str, deltas: Mapping[str, Array]) -> float:
    """How far the calibrated flange is from the drawing's at most, m.

    Single numbers tell nothing: the axes of the joints 2 to 4 are almost parallel, so that lengths of
    hundreds of metres make up for each other.
    """
    drawing, calibrated = UrArmModel(model), UrArmModel(model, DhDeltas(**deltas))
    apart = drawing.forward_many(_TRIED).translation - calibrated.forward_many(_TRIED).translation
    return float(np.linalg.norm(apart, axis=-1).max())


def _six(path: Path, kinematics: ElementTree.Element, tag: str) -> Array:
    element = kinematics.find(tag)
    text = "" if element is None else element.get("value", "")
    return _floats(path, f"kinematics/{tag}", text)


def _floats(path: Path, where: str, text: str) -> Array:
    try:
        values = np.array([float(v) for v in text.split(",")])
    except ValueError:
        values = np.zeros(0)
    if values.shape != (6,) or not np.isfinite(values).all():
        raise fault(path, where, "should be six numbers, one for each joint")
    return values


def _from_conf(path: Path, data: bytes, model: str | None) -> tuple[str, dict[str, Array]]:
    text = data.decode("utf-8", "replace")
    deltas = {}
    for key in _PARTS:
        match = re.search(rf"(?m)^\s*{key}\s*=\s*\[([^\]]*)\]", text)
        if match is None:
            raise fault(
                path, "", f"it has no '{key}': give an .installation, .urp or calibration.conf of a UR arm"
            )
        deltas[key] = _floats(path, key, match[1])
    if model is None:
        raise error("ARGUMENT_INVALID", f"{path} does not name the arm: give --model, as in --model ur10e")
    if _off(model, deltas) >= _NEAR_M:
        raise fault(path, "", f"its differences do not fit a {model}; give the right --model")
    return model, deltas
