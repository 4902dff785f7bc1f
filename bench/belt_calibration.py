"""How often the 95 % intervals of a belt's calibration hold the truth, and how wide they are.

``python -m bench.belt_calibration [RUNS]``: so many runs (200) of sightings with errors of every kind that
they may share, of touches, and a fifth as many of the whole job on virtual time for each belt. The width is
the median half of the interval over 1.96 RMS errors: 1 is the least that can be right.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from bench._expected import expect
from calibration.belt.scale import BeltScale
from procedures.belt.calibrating.rows import SightingRows
from procedures.belt.calibrating.solving import by_touch
from tests.kit.belt_runs import BELTS, calibrated
from tests.kit.belt_sightings import (
    BESIDE,
    FEW,
    MANY,
    NOISE,
    SCALE,
    USUAL,
    WAY,
    Error,
    Feed,
    coverage,
    nothing,
    of_frames,
    of_items,
    of_the_picture,
)  # fmt: skip

SIGHTINGS: dict[str, tuple[Error, Feed, float]] = {
    "independent": (nothing, USUAL, NOISE),
    "independent, 300": (nothing, MANY, NOISE),
    "independent, 26": (nothing, FEW, NOISE),
    "rougher along the belt": (nothing, USUAL, 3.0 * NOISE),
    "frames share the error of a count": (of_frames, USUAL, NOISE),
    "items are drawn out": (of_items, USUAL, NOISE),
    "a pattern over the picture": (of_the_picture, USUAL, NOISE),
}
TOUCHES = [(2, SCALE), (2, 10.0 * SCALE), (3, SCALE), (3, 10.0 * SCALE), (8, SCALE)]
TOUCH_SIGMA, TOUCH_WAY = 3e-4, 0.4


def touched(seed: int, touches: int, m_per_count: float) -> tuple[float, float, bool]:
    """Off and half of the interval, as shares of the scale, and whether the direction is held."""
    rng = np.random.default_rng([seed, touches])
    travel = np.sort(np.append(rng.uniform(0.0, TOUCH_WAY, touches - 2), [0.0, TOUCH_WAY]))
    travel += rng.uniform(0.0, m_per_count, touches) + rng.uniform(0.0, 1.0)
    points = travel[:, None] * WAY + rng.normal(0.0, TOUCH_SIGMA, (touches, 3))
    counts = np.floor(travel / m_per_count)
    rows = SightingRows(np.arange(float(touches)), points, counts, np.zeros(touches, dtype=np.int64))
    answer = expect(BeltScale, by_touch(rows, TOUCH_SIGMA))
    half_scale, half_angle = expect(float, answer.half_scale), expect(float, answer.half_angle)
    off = answer.m_per_count / m_per_count - 1.0
    return off, half_scale / m_per_count, bool(abs(answer.direction @ BESIDE) <= half_angle)


def row(what: str, runs: int, scale: float, width: float, angle: float | None = None) -> None:
    turned = "" if angle is None else f"{100 * angle:9.1f} %"
    print(f"{what:38s}{runs:6d}{100 * scale:9.1f} %{width:8.2f}{turned}", flush=True)


def main(runs: int) -> int:
    print(f"{'':38s}{'runs':>6s}{'scale':>11s}{'width':>8s}{'direction':>11s}")
    for what, (error, feed, along) in SIGHTINGS.items():
        found = coverage(runs, error, feed, along)
        row(what, runs, found.scale, found.width, found.angle)
    for touches, m in TOUCHES:
        off, half, turned = np.array([touched(seed, touches, m) for seed in range(runs)]).T
        width = np.median(half) / (1.96 * np.sqrt(np.mean(off**2)))
        what = f"{touches} touches, {1e3 * m:.1f} mm a count"
        row(what, runs, float(np.mean(np.abs(off) <= half)), float(width), float(np.mean(turned)))
    for belt, world in BELTS.items():
        jobs = []
        for seed in range(max(runs // 5, 1)):
            with tempfile.TemporaryDirectory() as folder:
                jobs.append(calibrated(Path(folder), seed, world))
        offs, halves = np.array([(job.off, job.half) for job in jobs]).T
        width = np.median(halves) / (1.96 * np.sqrt(np.mean(offs**2)))
        row(f"job: {belt}", len(jobs), float(np.mean(np.abs(offs) <= halves)), float(width))
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 200))
