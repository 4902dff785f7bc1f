"""Items found with depth of a stereo pair: how many, how far off, and whether the stated uncertainty holds.

``python -m bench.items_stereo [LOOKS] [--row N]``: looks at one item each (24; places and turns drawn over
the whole picture), with depth as drawn, with what a pair makes of it (``all`` has holes, 0.2 px noise and a
scale together), and by colour alone, there also smeared along the belt while the camera exposes. ``inside``
is the share of looks whose error is within the 95 % that is stated: 2.45 sigma, as the error has two axes.
``ms`` is the processor's time for a picture, the median.
"""

import argparse
import sys
import time

import numpy as np

from fakes.frames.stereo import stereo_depth
from fakes.world.camera.truth import StereoTruth
from tests.kit.item_scene import SIZE, T_BASE_CAMERA, Scene

LOOKS = 24
INSIDE = 2.448  # sigma of one axis, that hold 95 % of errors in a plane
FOUND, ERROR_M, HELD = 0.95, 0.5e-3, 0.95
DEPTHS: dict[str, StereoTruth | None] = {
    "as drawn": None,
    "pair, 0.1 px noise": StereoTruth(),
    "10 % holes": StereoTruth(holes=0.1),
    "30 % holes": StereoTruth(holes=0.3),
    "0.2 px noise": StereoTruth(noise_px=0.2),
    "2 % scale": StereoTruth(scale=1.02),
} | {
    f"all, {holes:.0%} holes, {scale:.2f}": StereoTruth(holes=holes, noise_px=0.2, scale=scale)
    for holes in (0.1, 0.3)
    for scale in (1.02, 0.98)
}
EXPOSURE_S = 0.1
BY_COLOUR = {"no depth, by colour": 0.0} | {
    f"  smeared over {1e3 * smear_m:.0f} mm": smear_m for smear_m in (0.006, 0.010, 0.015)
}


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("looks", nargs="?", type=int, default=LOOKS)
    parser.add_argument("--row", type=int, action="append", help="only this row, from 0")
    options = parser.parse_args()
    most = len(DEPTHS) + len(BY_COLOUR) - 1
    if any(not 0 <= row <= most for row in options.row or ()):
        parser.error(f"--row is 0 to {most}")
    looks, begun = options.looks, time.perf_counter()
    print(f"{looks} looks each; blobs of holes are 16 px")
    print(f"{'':22s}{'found %':>8s}{'RMS mm':>8s}{'most mm':>8s}{'says mm':>8s}{'inside %':>9s}{'ms':>6s}")
    good = True
    for number, name in enumerate((*DEPTHS, *BY_COLOUR)):
        if options.row and number not in options.row:
            continue
        scene = Scene()
        detector = scene.detector(**({"height_m": SIZE[2]} if name in BY_COLOUR else {}))
        stereo, speed_m_s = DEPTHS.get(name), BY_COLOUR.get(name, 0.0) / EXPOSURE_S
        rng = np.random.default_rng([7, looks])
        off, says, took = list[float](), list[float](), list[float]()
        for _ in range(looks):
            x, y, yaw = rng.uniform(-0.45, 0.45), rng.uniform(-0.7, -0.5), rng.uniform(0.0, np.pi)
            colour, depth = scene.picture([(x, y, yaw)], speed_m_s=speed_m_s, exposure_s=EXPOSURE_S)
            given = depth if stereo is None else stereo_depth(depth, stereo, rng)
            start = time.process_time()
            seen = detector.find(colour, None if name in BY_COLOUR else given)
            took.append(time.process_time() - start)
            for item in seen[:1]:
                off.append(float(np.linalg.norm(T_BASE_CAMERA.apply(item.point)[:2] - [x, y])))
                says.append(item.sigma_m)
        found, rms = len(off) / looks, float(np.sqrt(np.mean(np.square(off))))
        held = float(np.mean(np.array(off) <= INSIDE * np.array(says)))
        print(
            f"{name:22s}{100 * found:8.1f}{1e3 * rms:8.3f}{1e3 * max(off):8.3f}{1e3 * np.mean(says):8.3f}"
            f"{100 * held:9.1f}{1e3 * np.median(took):6.1f}",
            flush=True,
        )
        good &= found >= FOUND and (rms <= ERROR_M or held >= HELD)
    print(f"\nwithin all limits: {'yes' if good else 'NO'}   ({time.perf_counter() - begun:.0f} s)")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
