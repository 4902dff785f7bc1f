"""Where a slot is by a marker beside it: its number says which slot, the edges of its black square say where.

The corners of a marker are found for a start only: blur draws a corner inwards by a tenth of a pixel, which
makes the marker small and, as it is beside the slot, puts the slot aside. Depth and tilt hardly show in one
marker and stay as the rack's model has them. How well the marker sits beside the slot no picture tells: it is
told apart, for a budget, as what the answer follows of it. A second look begins at the answer of the first,
which follows it already.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.slot.edges import LEVEL_PX, PROFILE_PX
from calibration.slot.opening import Expected, FoundOpening, by_edges
from calibration.slot.rectangle import Rectangle, motion_px, project
from calibration.targets import Target
from cell.devices import Intrinsics
from cell.errors import error
from cell.poses import Array, adjoint, exp_xi, log_xi

_CORNER_PX = 0.3  # of a corner, with what blur does to it
_ROUNDS = 6
_OF_CELL = 0.8  # of a marker's border, as far as a profile across its edge may go
_LEAST_ROOM_PX = 1.5  # of a profile, for the levels at its ends
_TURNED = RigidTransform.from_rotation(Rotation.from_rotvec([np.pi, 0.0, 0.0]))  # z away from the viewer


@dataclass(frozen=True)
class SlotMarker:
    """``target``, a square of ``size_m`` and ``cells`` cells across, with its frame ``T_slot`` in the slot's;
    that is known to ``cov`` (6, 6), perturbation on the right."""

    target: Target
    name: str
    size_m: float
    cells: int
    T_slot: RigidTransform
    cov: Array


def find_by_marker(
    colour: NDArray[np.uint8],
    camera: Intrinsics,
    marker: SlotMarker,
    expected: Expected,
    reach_m: float,
    looks: int = 1,
) -> FoundOpening:
    """The slot by its marker in ``colour`` (h, w, 3), at most ``reach_m`` beside ``expected``.

    ``looks`` at the marker so far, this one included; each but the first begins at the answer of the one
    before, with about the same ``expected.cov``.

    ``OPENING_NOT_SEEN`` where the marker is not in the picture, is elsewhere, or too small there.
    """
    square, T_slot = Rectangle(marker.size_m, marker.size_m), marker.T_slot * _TURNED
    to_marker = adjoint(T_slot.inv().as_matrix())
    own = Expected(expected.T_camera * T_slot, to_marker @ expected.cov @ to_marker.T)
    start, side_px = _start(colour, camera, marker, own)
    beside = float(np.linalg.norm((own.T_camera.inv() * start).translation[:2]))
    if beside > reach_m:
        raise error(
            "OPENING_NOT_SEEN",
            f"{marker.name} is {1e3 * beside:.1f} mm beside where it should be, and it is looked for within "
            f"{1e3 * reach_m:.1f} mm",
        )
    profile_px = min(PROFILE_PX, _OF_CELL * side_px / marker.cells)
    if profile_px < LEVEL_PX + _LEAST_ROOM_PX:
        least = (LEVEL_PX + _LEAST_ROOM_PX) / _OF_CELL * marker.cells
        raise error(
            "OPENING_NOT_SEEN",
            f"{marker.name} is {side_px:.0f} px wide in the picture, and {least:.0f} px are needed: look "
            "from nearer, or print it larger",
        )
    found = by_edges(colour, camera, square, own, start, profile_px)
    back = adjoint(T_slot.as_matrix())
    turn = adjoint(_TURNED.inv().as_matrix())
    kept = np.linalg.matrix_power(found.cov @ np.linalg.inv(own.cov), looks)
    follows = back @ (np.eye(6) - kept) @ turn
    return replace(
        found,
        T_camera=found.T_camera * T_slot.inv(),
        cov=back @ found.cov @ back.T,
        by_marker=follows @ marker.cov @ follows.T,
    )


def _start(
    colour: NDArray[np.uint8], camera: Intrinsics, marker: SlotMarker, own: Expected
) -> tuple[RigidTransform, float]:
    """The marker's square in the camera by its corners, and how wide it is there, px."""
    seen = marker.target.detect(colour)
    if seen is None:
        raise error("OPENING_NOT_SEEN", f"{marker.name} is not in the picture, or more than once")
    points = _TURNED.inv().apply(marker.target.points[seen.ids])
    prior, T = np.linalg.inv(own.cov), own.T_camera
    for _ in range(_ROUNDS):
        J = motion_px(camera, T, points).reshape(-1, 6) / _CORNER_PX
        off = (seen.corners - project(camera, T, points)).ravel() / _CORNER_PX
        N = prior + J.T @ J
        T = T * exp_xi(np.linalg.solve(N, J.T @ off - prior @ log_xi(own.T_camera.inv() * T)))
    sides = np.linalg.norm(seen.corners - np.roll(seen.corners, 1, axis=0), axis=1)
    return T, float(sides.min())
