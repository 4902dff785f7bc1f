"""The camera of the object face with pictures: what is captured is drawn, and a detector looks at it."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from calibration.targets import make_target
from cell.devices import BoardView, Frame
from fakes.frames.plates import make_plate
from fakes.frames.render import Optics, Renderer
from fakes.object import ObjectCamera


class DrawnCamera(ObjectCamera):
    """As the frame server draws and the vision child detects, in this process and on virtual time.

    Frames that nobody captures, as those of a search for the board, keep the corners that are computed.
    """

    @cached_property
    def _renderer(self) -> Renderer:
        world = self.world
        optics = Optics(world.intrinsics, grey=world.camera.grey, seed=world.config.seed)
        return Renderer(optics, make_plate(world.target, world.printed))

    async def capture(self, count: int, folder: Path, stem: str, after: float) -> Sequence[Frame]:
        """``count`` frames exposed wholly after ``after``, each of them drawn; no files are written."""
        frames = await super().capture(count, folder, stem, after)
        return [replace(frame, board=self._detected(frame.t_exposure)) for frame in frames]

    def _detected(self, t: float) -> BoardView | None:
        colour = self._renderer.render([self.world.scene(t).T_camera_target]).colour
        found = make_target(self.world.target).detect(colour)
        if found is None:
            return None
        return BoardView(np.asarray(found.ids, dtype=np.int64), found.corners, float(colour.mean()))
