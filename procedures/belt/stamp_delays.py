"""What is known of how late the stamps of camera and encoder are, and what an unknown delay costs.

An item that is seen ``c`` late is taken for farther back by ``c`` times the belt's speed, and so is every
contact. The counts at picture and contact are late by the same ``e``: at an even speed that cancels, and else
it leaves ``e`` times the change of the speed between the two.
"""

from collections.abc import Mapping

from cell.formats.result import Warning_

_SIGMAS_95 = 1.96
_CAMERA, _ENCODER = "fixed_camera", "belt"  # roles
_COSTS = {
    _CAMERA: "how late the stamps of the camera are was not measured: 10 ms would put every contact off by 1 "
    "mm along the belt at 0.1 m/s, unseen here",
    _ENCODER: "how late the stamps of the encoder are was not measured: 10 ms would put a contact off by 1 "
    "mm along the belt where the belt's speed changes by 0.1 m/s between picture and contact (at an even "
    "speed nothing)",
}
Offsets = Mapping[str, Mapping[str, float]]


def camera_delay_95_s(offsets: Offsets) -> float | None:
    """Half of the 95 % interval of the camera's delay, s; None where it was not measured.

    ``offsets`` are those in effect by role, with the ``sigma`` of one that was measured. That of the encoder
    does not count: it was measured against the camera, so the camera is in it already.
    """
    sigma = offsets.get(_CAMERA, {}).get("sigma")
    return None if sigma is None else _SIGMAS_95 * sigma


def delay_sigmas(offsets: Offsets) -> tuple[float | None, float | None]:
    """Standard deviations (s) of the delays of camera and encoder; None of one that was not measured."""
    camera, encoder = (offsets.get(role, {}).get("sigma") for role in (_CAMERA, _ENCODER))
    return camera, encoder


def delay_warnings(offsets: Offsets) -> list[Warning_]:
    """One for each delay that is not known, with what that can cost and what measures it."""
    return [
        Warning_(code="belt.delays", text=f'{cost}; run latency-calibration with source = "{role}"')
        for role, cost in _COSTS.items()
        if "sigma" not in offsets.get(role, {})
    ]
