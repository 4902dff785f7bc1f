"""The object face of the twin: drivers and a clock on virtual time, named in a config.

``fakes.object:ObjectArm``, ``ObjectCamera`` and their like are drivers, ``VirtualClock`` is their clock, and
``run_virtual`` runs a coroutine on the loop that all of them live on.
"""

from fakes.object.arm import ObjectArm
from fakes.object.camera import ObjectCamera
from fakes.object.clock import VirtualClock
from fakes.object.encoder import ObjectEncoder
from fakes.object.gripper import ObjectGripper
from fakes.object.inputs import ObjectInputs
from fakes.object.loop import DeadlockError, VirtualTimeLoop, run_virtual
from fakes.object.observed import ObjectObservedArm
from fakes.object.place_inputs import ObjectPlaceInputs
from fakes.object.registry import ObjectCell, cell_of, world_of
from fakes.object.tracker import ObjectTracker

__all__ = [
    "DeadlockError",
    "ObjectArm",
    "ObjectCamera",
    "ObjectCell",
    "ObjectEncoder",
    "ObjectGripper",
    "ObjectInputs",
    "ObjectObservedArm",
    "ObjectPlaceInputs",
    "ObjectTracker",
    "VirtualClock",
    "VirtualTimeLoop",
    "cell_of",
    "run_virtual",
    "world_of",
]
