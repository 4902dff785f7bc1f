"""The frame server: rendered exposures of the world on a unix stream socket.

Exposures lie on a fixed grid of CLOCK_MONOTONIC and are drawn only while somebody is connected. Each
client has a thread and a slot for one frame: a newer frame replaces one that was not yet begun to be sent,
so a slow reader loses frames and ``seq`` shows it, but no frame waits behind others.
"""

import contextlib
import json
import os
import signal
import socket
import struct
import threading
import time
from dataclasses import replace
from multiprocessing.connection import Connection

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from fakes.faults.vocabulary import Fault
from fakes.frames.belt_view import belt_seen, boxes_seen
from fakes.frames.faults import FrameFaults
from fakes.frames.plates import make_plate
from fakes.frames.rack_view import RackView
from fakes.frames.render import Optics, Picture, Renderer
from fakes.world.camera.autofocus import focal_share, lens_position
from fakes.world.camera.exposure import Exposure, times_in
from fakes.world.scenario import Scenario
from fakes.world.world import Message, World

# The world's changes come through a pipe; a scene is looked at when those up to its time have arrived.
_MIRROR_LAG_S = 0.012
_JUNK = bytes(range(256)) * 64


def serve_frames(socket_path: str, scenario_path: str, connection: Connection) -> None:
    """Entry point of the twin's camera process; returns when the other end of ``connection`` closes.

    It listens when the first message has come: until then another twin may own the socket.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the twin ends us in order
    cv2.setNumThreads(1)
    scenario = Scenario.load(scenario_path)
    world = World.from_scenario(scenario, time.monotonic())
    try:
        first = connection.recv()
    except (EOFError, OSError):
        return
    server = FrameServer(world, socket_path)
    for message in first:
        server.handle(message)
    mirror = threading.Thread(target=_follow, args=(server, connection), name="mirror", daemon=True)
    mirror.start()
    try:
        server.run()
    finally:
        server.close()


def _follow(server: "FrameServer", connection: Connection) -> None:
    try:
        while True:
            for message in connection.recv():
                server.handle(message)
    except (EOFError, OSError):
        server.stop()


class FrameServer:
    """Listens at once; :meth:`run` exposes and sends until :meth:`stop`."""

    def __init__(self, world: World, socket_path: str) -> None:
        self.world, self.faults = world, FrameFaults()
        self.exposures = 0
        camera = world.camera
        self._camera = camera
        self._told = world.told_intrinsics
        self._readout_s = camera.row_time_s * camera.height
        self._renderer = Renderer(
            Optics(
                world.intrinsics,
                grey=camera.grey,
                noise_grey=camera.noise_grey,
                blur_px=camera.blur_px,
                vignette=camera.vignette,
                stereo=camera.stereo,
                seed=world.config.seed,
            ),
            make_plate(world.target, world.printed),
            belt_seen(world),
        )
        self._rack = None if world.rack is None else RackView(world, world.rack)
        self._rng = np.random.default_rng([world.config.seed, 0x57A])
        self._lock = threading.Lock()  # of the world, the faults and the list of clients
        self._stopping = threading.Event()
        self._clients: list[_Client] = []
        self._connected = threading.Event()
        self._last: bytes | None = None
        self._path = socket_path
        with contextlib.suppress(FileNotFoundError):
            os.unlink(socket_path)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(socket_path)
        self._listener.listen(8)
        self._listener.settimeout(0.1)
        self._acceptor = threading.Thread(target=self._accept, name="frames accept", daemon=True)
        self._acceptor.start()

    def handle(self, message: Message) -> None:
        """Take one message of the twin: a fault, or a change of the world."""
        with self._lock:
            match message:
                case ("fault", name, arguments):
                    self.faults.begin(Fault(name), arguments)
                case ("clear",):
                    self.faults.clear()
                case _:
                    self.world.apply(message)

    def stop(self) -> None:
        """Make :meth:`run` return."""
        self._stopping.set()
        self._connected.set()

    def close(self) -> None:
        """End all connections and threads, and remove the socket."""
        self.stop()
        self._acceptor.join()
        self._listener.close()
        self._cut()
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._path)

    def run(self) -> None:
        """Expose on the grid, as long as somebody looks."""
        period = self._camera.period_s
        origin = time.monotonic()
        while not self._stopping.is_set():
            self._connected.wait(0.05)
            self.faults.die_if_told()
            if self.faults.take_cut():
                self._cut()
            if not self._living_clients():
                self._connected.clear()
                continue
            seq = int((time.monotonic() - origin) / period) + 1
            self._expose(seq, origin + seq * period)

    def _expose(self, seq: int, t: float) -> None:
        """Wait for the exposure around ``t`` to end, draw it, and hand it over after the camera's latency."""
        exposure = self._camera.exposure(self.faults.gain)
        self._wait_until(t + self._readout_s + 0.5 * exposure.time_s + _MIRROR_LAG_S)
        picture = self._focused(self._picture(t, seq, exposure), t)
        self._wait_until(t + self._camera.latency_s + self.faults.delay_s)
        data = self._encoded(seq, self._stamp(t), exposure.time_s, picture, self._lens_position(t))
        if self.faults.silent:
            return
        if self.faults.freeze and self._last is not None:
            data = self._last
        self._last = data
        for client in self._living_clients():
            client.offer(_JUNK if self.faults.junk else data)
        self.exposures += 1

    def _stamp(self, t: float) -> float:
        """When the camera says that the first row was exposed."""
        late = self._camera.stamp_late_s + self._camera.stamp_jitter_s * float(self._rng.standard_normal())
        return t + self.faults.jump_s + late

    def _lens_position(self, t: float) -> int | None:
        """Of 255, as the camera tells it; a lens that cannot move has none."""
        return lens_position(t) if self._camera.autofocus else None

    def _focused(self, picture: Picture, t: float) -> Picture:
        """The picture with the focal length that an autofocus has just now."""
        if not self._camera.autofocus:
            return picture
        f, size = focal_share(t), (self._camera.width, self._camera.height)
        cx, cy = self._camera.K[2:]
        larger = np.array([[f, 0.0, (1.0 - f) * cx], [0.0, f, (1.0 - f) * cy]])
        colour = cv2.warpAffine(picture.colour, larger, size, borderMode=cv2.BORDER_REPLICATE)
        return replace(picture, colour=colour.astype(np.uint8, copy=False))

    def _picture(self, t: float, seq: int, exposure: Exposure) -> Picture:
        """What the camera sees; of a rack only while no board stands in the cell, which would cover it.

        What moves is smeared over the exposure, each part of it by the rows on which it lies. A rack is
        drawn at ``t`` alone: it is looked at by an arm at rest.
        """
        with self._lock:
            rack = self._rack if self.world.operator.placement_at(t) is None else None
            T_base_camera = self.world.scene(t).T_base_camera
        if rack is not None:  # drawn without the lock, for it takes longer than set-points may wait
            return Picture(*rack.drawn(T_base_camera, t, seq))
        with self._lock:
            times = times_in(t, exposure.time_s, self._smear_px(t, exposure.time_s)).tolist()
            poses = [None if self.faults.lost_board else self._target(k) for k in times]
            boxes = boxes_seen(self.world, times)
        return self._renderer.render(poses, exposure.gain, boxes)

    def _target(self, t: float) -> RigidTransform | None:
        """The target as the row on which its origin lies sees it in the picture that begins at ``t``."""
        seen = self.world.scene(t).T_camera_target
        if seen is None or not self._camera.row_time_s or seen.translation[2] <= 0.0:
            return seen
        return self.world.scene(t + float(self._camera.row_delay_s(seen.translation))).T_camera_target

    def _smear_px(self, t: float, time_s: float) -> float:
        """How far the target, or the belt, moves in the image during the exposure around ``t``."""
        ends, moved = (t - 0.5 * time_s, t + 0.5 * time_s), 0.0
        scenes = [self.world.scene(k) for k in ends]
        if (belt := self.world.belt) is not None:
            above = (belt.T_base_belt.inv() * scenes[0].T_base_camera).translation[2]
            moved = abs(belt.travel_at(ends[1]) - belt.travel_at(ends[0])) / max(float(above), 0.1)
        a, b = (scene.T_camera_target for scene in scenes)
        if a is not None and b is not None:
            turn = (a.rotation.inv() * b.rotation).magnitude()
            shift = np.linalg.norm(a.translation - b.translation) / max(a.translation[2], 0.1)
            moved = max(moved, float(turn + shift))
        return self._camera.K[0] * moved

    def _encoded(
        self, seq: int, t: float, exposure_s: float, picture: Picture, lens_position: int | None
    ) -> bytes:
        camera = self._camera
        header = json.dumps(
            {
                "seq": seq,
                "t_exposure": t,
                "exposure_s": exposure_s,
                "row_time_s": camera.row_time_s,
                "lens_position": lens_position,
                "width": camera.width,
                "height": camera.height,
                "K": self._told.K,
                "dist": self._told.dist,
                "colour": "bgr8",
                "depth": "u16mm" if camera.depth else None,
                "serial": self.faults.serial or camera.serial,
            }
        ).encode()
        colour = picture.colour.tobytes()
        depth = picture.depth.astype("<u2", copy=False).tobytes() if camera.depth else b""
        return b"".join((struct.pack("<I", len(header)), header, colour, depth))

    def _accept(self) -> None:
        while not self._stopping.is_set():
            try:
                connection, _ = self._listener.accept()
            except TimeoutError:
                continue
            if self.faults.refuse:
                connection.close()
                continue
            with self._lock:
                self._clients.append(_Client(connection))
            self._connected.set()

    def _living_clients(self) -> list["_Client"]:
        with self._lock:
            self._clients = [c for c in self._clients if c.alive]
            return list(self._clients)

    def _cut(self) -> None:
        with self._lock:
            clients, self._clients = self._clients, []
        for client in clients:
            client.close()

    def _wait_until(self, t: float) -> None:
        self._stopping.wait(max(t - time.monotonic(), 0.0))


class _Client:
    """One reader: a thread that sends the newest frame there is."""

    def __init__(self, connection: socket.socket) -> None:
        self.alive = True
        self._connection = connection
        self._slot: bytes | None = None
        self._filled = threading.Condition()
        self._thread = threading.Thread(target=self._send, name="frames client", daemon=True)
        self._thread.start()

    def offer(self, data: bytes) -> None:
        """Make ``data`` what is sent next, in place of anything that still waits."""
        with self._filled:
            self._slot = data
            self._filled.notify()

    def close(self) -> None:
        """End the connection and the thread."""
        self.alive = False
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)
        with self._filled:
            self._filled.notify()
        self._thread.join()

    def _send(self) -> None:
        with self._connection:
            try:
                while (data := self._next()) is not None:
                    self._connection.sendall(data)
            except OSError:
                pass  # the reader went away
            self.alive = False

    def _next(self) -> bytes | None:
        with self._filled:
            while self._slot is None:
                if not self.alive or self._peer_closed():
                    return None
                self._filled.wait(0.2)
            data, self._slot = self._slot, None
            return data

    def _peer_closed(self) -> bool:
        try:
            return self._connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) == b""
        except BlockingIOError:
            return False
