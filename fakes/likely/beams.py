"""Crossed beams on the way that the configuration gives the tool, and the module that reads them."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from cell.known_cell import KnownBeam, KnownCell
from cell.poses import Array
from fakes.likely.arm import tool_point
from fakes.world.arm.kinematics import Chain
from fakes.world.beams.truth import CHANNELS

TILT_RAD = 0.002  # of a bracket that was made with a level
GAP_M = 0.0005  # in height, between the two
BELOW = (
    0.15,
    0.6,
)  # share of the reach of the search at which the beams are: the operator taught it above them
SPOT_M, HYSTERESIS_M = 0.0005, 0.00005  # radius of a focused beam, and of the switching point: assumptions
LATENCY_S = 0.002
# A filter that is set short, as it has to be for the beams, where no section tells it. How often a module
# looks, none does. Assumptions, as in the scenario laser.
FILTER_S, SCAN_S = 0.001, 0.001
SERIAL = "99993300001"


def draw_beams(known: KnownCell, arm: Chain, rng: np.random.Generator) -> dict[str, Any]:
    """``beams`` and ``io`` of a scenario's world."""
    told = known.beams
    if told is None:
        raise ValueError("no beams are known")
    starts = {name: tool_point(known, arm, np.array(beam.q_aux)) for name, beam in told.beams.items()}
    depth = told.reach_m * rng.uniform(*BELOW)
    height = min(float(p[2]) for p in starts.values()) - depth
    return {
        "beams": {
            name: _beam(beam, starts[name], height + GAP_M * rng.uniform(-0.5, 0.5), rng)
            for name, beam in told.beams.items()
        },
        "io": {
            "serial": SERIAL,
            "inputs": _channels(told.beams),
            "filter_s": FILTER_S if told.filter_s is None else told.filter_s,
            "counters": told.counters,
            "scan_s": SCAN_S,
        },
    }


def _channels(beams: Mapping[str, KnownBeam]) -> dict[str, int]:
    """Those of the section; the first ones where a module has more than that of a twin."""
    channels = {name: beam.channel for name, beam in beams.items()}
    if max(channels.values()) < CHANNELS["generic"]:
        return channels
    return {name: number for number, name in enumerate(beams)}


def _beam(beam: KnownBeam, start: Array, height: float, rng: np.random.Generator) -> dict[str, Any]:
    across = np.array([beam.across[0], beam.across[1], 0.0])
    across /= np.linalg.norm(across)
    along = np.array([-across[1], across[0], 0.0])
    middle = start + across * beam.distance_m * rng.uniform(0.4, 0.6) + along * beam.along_m / 2.0
    direction = along + TILT_RAD * rng.standard_normal(3)
    return {
        "point": [float(middle[0]), float(middle[1]), height],
        "dir": direction.tolist(),
        "length_m": abs(beam.along_m) + 0.15,
        "radius_m": SPOT_M,
        "latency_s": LATENCY_S,
        "hysteresis_m": HYSTERESIS_M,
    }
