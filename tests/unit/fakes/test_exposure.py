"""What moves while the twin's camera exposes is smeared in its picture; what rests is not."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fakes.frames.server import FrameServer
from fakes.world.camera.exposure import AutoExposureTruth, times_in
from fakes.world.scenario import Scenario
from fakes.world.world import World
from tests.kit.object_items import items_of_seconds

SMALL = {"width": 320, "height": 200, "K": [200.6, 200.4, 161.0, 99.2], "dist": []}
DIM = AutoExposureTruth(light_lux=60.0)  # 0.135 s


@pytest.mark.parametrize(
    ("light", "time_s", "gain"),
    [(1.0, 0.027, 1.0), (10.0, 0.0027, 1.0), (0.1, 0.1, 1.0), (0.01, 0.1, 16 * 0.1 / 2.7)],
)
def test_exposure_follows_the_light_up_to_the_frames_time_and_then_sensitivity_does(
    light: float, time_s: float, gain: float
) -> None:
    found = AutoExposureTruth().exposure(0.1, light)
    assert (found.time_s, found.gain) == pytest.approx((time_s, gain))


def test_an_exposure_is_drawn_at_the_middles_of_equal_parts() -> None:
    assert times_in(2.0, 0.1, 0.2).tolist() == [2.0]
    assert times_in(2.0, 0.1, 4.2) == pytest.approx([1.96, 1.98, 2.0, 2.02, 2.04])
    assert len(times_in(2.0, 0.1, 500.0)) == 31


def picture(name: str, t: float, speed: float = 0.0, **camera: Any) -> NDArray[np.int16]:
    """What the camera of a small, ideal ``name`` shows at ``t`` while belt or arm move with ``speed``."""
    truth = Scenario.load(f"{name}:ideal").world
    changes: dict[str, Any] = {"camera": truth.camera.model_copy(update=SMALL | camera)}
    if truth.belt is not None:
        piece = truth.belt.profile[0].model_copy(update={"speed_m_s": speed})
        changes["belt"] = truth.belt.model_copy(update={"profile": [piece]})
        changes["items"] = truth.items.model_copy(update={"first_m": -0.046 - speed * t})
    world = World(truth.model_copy(update=changes), 0.0)
    if truth.belt is None and speed:
        q = world.track.at(0.0)[0].copy()
        q[0] += 0.5
        world.track.start_joint_move(0.0, q, speed, 10.0)
    with tempfile.TemporaryDirectory() as folder:
        server = FrameServer(world, str(Path(folder) / "frames.sock"))
        try:
            return server._picture(t, 1, world.camera.exposure()).colour.astype(np.int16)
        finally:
            server.close()


def steepest(image: NDArray[np.int16]) -> float:
    """The steepest edges along a row."""
    return float(np.percentile(np.abs(np.diff(image[..., 2], axis=1)), 99.8))


@pytest.mark.parametrize(("name", "speed"), [("picking", 0.3), ("hand_eye", 1.0)])
def test_automatic_exposure_smears_what_moves_and_leaves_what_rests(name: str, speed: float) -> None:
    rests = [picture(name, 1.0, 0.0, **how) for how in ({}, {"auto_exposure": DIM})]
    assert (rests[0] == rests[1]).all()
    short, long = (
        picture(name, 0.3, speed, **how) for how in ({"exposure_s": 0.001}, {"auto_exposure": DIM})
    )
    assert steepest(long) < 0.6 * steepest(short)


def test_the_object_camera_is_as_unsure_of_smeared_items_as_it_is_off() -> None:
    (_, sharp), (_, smeared) = (items_of_seconds(20, auto_exposure=auto) for auto in (None, DIM))
    off = np.array([a.point - b.point for a, b in zip(smeared, sharp, strict=True)])
    says = smeared[0].sigma_m
    assert says > 10.0 * sharp[0].sigma_m
    assert 0.5 * says < np.sqrt(np.mean(np.sum(off**2, axis=1))) < 1.5 * says
