"""From an exposure to corners: accuracy and time of the detector, and delay and cost of the camera chain.

First table: the same rendered pictures through OpenCV's own ChArUco detector and through ours (the
detector that the vision child uses). Second table: a frame server at 10 frames a second, read side by side
by our driver (depthai host pipeline in a child, corners over a pipe) and by a bare reader (socket and the
same detector in one process). "Delay" counts from the delivery that the server aims at to corners in hand.
"""

import asyncio
import multiprocessing
import tempfile
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
from scipy.spatial.transform import RigidTransform, Rotation

from bench._expected import expect
from calibration.targets import make_target
from cell.clock import MonotonicClock
from drivers.oak import OakCamera
from drivers.oak.frame_socket import FrameGroup, FrameSocket
from fakes.frames.plates import make_plate
from fakes.frames.render import Optics, Renderer
from fakes.twin.mirror import FrameProcess
from fakes.world.camera.truth import CameraTruth
from fakes.world.scenario import Scenario
from fakes.world.world import World

SCENARIO = "hand_eye"
PICTURES = 40
SECONDS = 10.0

Found = tuple[Any, Any]  # ids (n,), corners (n, 2)


def main() -> None:
    cv2.setNumThreads(1)
    accuracy()
    chain()


def accuracy() -> None:
    truth = Scenario.load(SCENARIO).world
    world, target = World(truth, 0.0), expect(dict, truth.target)
    renderer = Renderer(Optics(world.intrinsics), make_plate(target))
    detectors = {"OpenCV": opencv_detector(target), "ours": our_detector(target)}
    errors: dict[str, list[Any]] = {name: [] for name in detectors}
    times: dict[str, list[float]] = {name: [] for name in ("render", *detectors)}
    rng = np.random.default_rng(5)
    for _ in range(PICTURES):
        pose = random_view(rng)
        start = time.perf_counter()
        picture = renderer.render([pose])
        times["render"].append(time.perf_counter() - start)
        grey = cv2.cvtColor(picture.colour, cv2.COLOR_BGR2GRAY)
        for name, detect in detectors.items():
            start = time.perf_counter()
            ids, corners = detect(grey)
            times[name].append(time.perf_counter() - start)
            errors[name].append(corners - true_corners(world, pose, ids))
    print(f"{PICTURES} pictures of 1280x800 with depth, board at 0.35 to 0.65 m, one thread")
    print(f"{'':10}{'p50 ms':>9}{'p99 ms':>9}{'corners':>9}{'bias x px':>11}{'bias y px':>11}{'RMS px':>9}")
    print(f"{'render':10}{ms(times['render'], 50)}{ms(times['render'], 99)}")
    for name in detectors:
        e = np.concatenate(errors[name])
        bias = e.mean(axis=0)
        print(
            f"{name:10}{ms(times[name], 50)}{ms(times[name], 99)}{len(e):9}{bias[0]:11.4f}{bias[1]:11.4f}"
            f"{np.sqrt(np.mean(e**2)):9.4f}"
        )


def random_view(rng: np.random.Generator) -> RigidTransform:
    rotation = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3))
    centre = [*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.35, 0.65)]
    return RigidTransform.from_components(centre - rotation.apply([0.125, 0.0875, 0.0]), rotation)


def true_corners(world: World, T_camera_target: RigidTransform, ids: Any) -> Any:
    k = np.asarray(ids)
    points = np.column_stack([k % 9 + 1, k // 9 + 1, np.zeros(len(k))]) * 0.025
    seen = np.ascontiguousarray(T_camera_target.apply(points))
    camera = world.intrinsics
    dist = np.array(camera.dist)
    return cv2.projectPoints(seen, np.zeros(3), np.zeros(3), camera.matrix, dist)[0].reshape(-1, 2)


def opencv_detector(target: dict[str, Any]) -> Callable[[Any], Found]:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, target["dictionary"]))
    size = (target["squares_x"], target["squares_y"])
    board = cv2.aruco.CharucoBoard(size, target["square_m"], target["marker_m"], dictionary)
    detector = cv2.aruco.CharucoDetector(board)

    def detect(grey: Any) -> Found:
        corners, ids, _, _ = detector.detectBoard(grey)
        return (np.zeros(0, int), np.zeros((0, 2))) if ids is None else (ids.ravel(), corners.reshape(-1, 2))

    return detect


def our_detector(target: dict[str, Any]) -> Callable[[Any], Found]:
    detector = make_target(target)

    def detect(grey: Any) -> Found:
        found = detector.detect(grey)
        return (np.zeros(0, int), np.zeros((0, 2))) if found is None else (found.ids, found.corners)

    return detect


def chain() -> None:
    scenario = Scenario.load(SCENARIO)
    camera, target = expect(CameraTruth, scenario.world.camera), expect(dict, scenario.world.target)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frames.sock"
        server = FrameProcess(str(path), SCENARIO, World.from_scenario(scenario, time.monotonic()))
        server.start()
        try:
            while not path.exists():
                time.sleep(0.05)
            context = multiprocessing.get_context("spawn")
            ours, theirs = context.Pipe()
            bare = context.Process(target=bare_reader, args=(str(path), target, theirs))
            bare.start()
            rows = {"driver": asyncio.run(our_driver(path, target, ours))}
            rows["bare"] = ours.recv()
            bare.join()
        finally:
            server.stop()
    print(f"\n{SECONDS:.0f} s at {1 / camera.period_s:.0f} frames a second, both at once")
    print(f"{'':10}{'p50 ms':>9}{'p99 ms':>9}{'frames':>9}{'lost':>9}{'CPU %':>9}")
    for name, (arrivals, cpu_s) in rows.items():
        delays = [arrival - t - camera.latency_s for _, t, arrival in arrivals]
        lost = arrivals[-1][0] - arrivals[0][0] + 1 - len(arrivals)
        print(
            f"{name:10}{ms(delays, 50)}{ms(delays, 99)}{len(arrivals):9}{lost:9}{100 * cpu_s / SECONDS:9.1f}"
        )


Arrivals = list[tuple[int, float, float]]  # seq, mid exposure, arrival


async def our_driver(path: Path, target: dict[str, Any], go: Connection) -> tuple[Arrivals, float]:
    camera = OakCamera(
        "camera", OakCamera.Config.model_validate({"source": f"frames+unix://{path}"}), MonotonicClock()
    )
    await camera.set_target(target)
    await camera.open()
    try:
        await camera.wait_fresh(5.0)
        arrivals: Arrivals = []
        child = psutil.Process(camera.health()["child_pid"])
        go.send("go")
        before = cpu_s(child)
        camera.frames.subscribe(lambda s: arrivals.append((s.seq, s.t, time.monotonic())))
        await asyncio.sleep(SECONDS)
        return arrivals, cpu_s(child) - before
    finally:
        await camera.close()


def bare_reader(path: str, target: dict[str, Any], pipe: Connection) -> None:
    """Socket and detector in one process; begins when told."""
    cv2.setNumThreads(1)
    detect = our_detector(target)
    pipe.recv()
    frames = FrameSocket(path)
    me = psutil.Process()
    arrivals: Arrivals = []
    before, end = cpu_s(me), time.monotonic() + SECONDS
    while time.monotonic() < end:
        group = expect(FrameGroup, frames.read())
        detect(cv2.cvtColor(group.colour, cv2.COLOR_BGR2GRAY))
        arrivals.append((group.seq, group.t_exposure, time.monotonic()))
    frames.close()
    pipe.send((arrivals, cpu_s(me) - before))


def cpu_s(process: psutil.Process) -> float:
    spent = process.cpu_times()
    return float(spent.user + spent.system)


def ms(seconds: list[float], percentile: float) -> str:
    return f"{1000.0 * float(np.percentile(seconds, percentile)):9.1f}"


if __name__ == "__main__":
    main()
