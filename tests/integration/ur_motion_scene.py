"""The controller of a module, and moves to be asked of it."""

from collections.abc import Iterator

import numpy as np
import pytest
from ur_driver_rig import LASTING, Rig

from cell.devices import Speed, TrajectoryPiece
from drivers.ur import UrArm

SPEED = Speed(tcp_m_s=0.25, tcp_m_s2=1.0, joint_rad_s=1.0, joint_rad_s2=4.0)
SLOW = Speed(tcp_m_s=0.02, tcp_m_s2=0.5, joint_rad_s=0.05, joint_rad_s2=0.5)


@pytest.fixture(scope="module")
def shared() -> Iterator[Rig]:
    with Rig.running() as rig:
        yield rig


@pytest.fixture
def rig(shared: Rig, request: pytest.FixtureRequest) -> Iterator[Rig]:
    """The module's controller, or one of its own for a test that spoils it."""
    call = getattr(request.node, "callspec", None)
    if call is not None and call.params.get("fault") in LASTING:
        with Rig.running() as own:
            yield own
    else:
        yield shared
        shared.tidy()


def joints(arm: UrArm) -> np.ndarray:
    return arm.state.latest(0.5).value.q.copy()


def turned(arm: UrArm, angle: float) -> np.ndarray:
    return joints(arm) + np.array([angle, 0, 0, 0, 0, 0])


def quintic(t0: float, duration: float, q0: np.ndarray, travel: np.ndarray) -> TrajectoryPiece:
    """Rest to rest (Craig, Introduction to Robotics, 7.3)."""
    c = np.zeros((6, 6))
    c[0] = q0
    c[3], c[4], c[5] = (k * travel / duration**p for k, p in ((10, 3), (-15, 4), (6, 5)))
    return TrajectoryPiece(t0, t0 + duration, c)
