"""One world for all devices of an object cell: found by scenario and clock."""

import asyncio
from typing import TypeVar

from cell.clock import Clock
from cell.errors import error
from fakes.object._plant import Plant
from fakes.object.controller import Controller
from fakes.object.encoder_plant import EncoderPlant
from fakes.object.head import CameraHead
from fakes.object.input_plant import InputPlant
from fakes.object.observed_plant import ObservedPlant
from fakes.object.tracker_plant import TrackerPlant
from fakes.world.scenario import FaultEntry, Scenario
from fakes.world.world import World

P = TypeVar("P", bound=Plant)
PLACE_SERIAL = "99993300002"


class ObjectCell:
    """The physical side: world, robot controller, what else the scenario has, and its faults."""

    def __init__(self, scenario: Scenario, clock: Clock) -> None:
        self.scenario = scenario
        self.world = World.from_scenario(scenario, clock.now())
        self.controller = Controller(self.world, clock)
        self.plants: dict[str, Plant] = {"arm": self.controller}
        if scenario.world.camera is not None:
            self.plants["camera"] = CameraHead(self.world, clock)
        if self.world.inputs is not None:
            self.plants["beams"] = InputPlant(self.world.inputs, clock)
        if self.world.encoder is not None:
            self.plants["belt"] = EncoderPlant(self.world.encoder, clock)
        if self.world.observed is not None:
            self.plants["palletizer"] = ObservedPlant(self.world.observed, clock)
        if self.world.tracker is not None:
            self.plants["tracker"] = TrackerPlant(self.world.tracker, clock)
        if self.world.place is not None:
            self.plants["place_inputs"] = Plant("place_inputs", clock, PLACE_SERIAL)
        self._clock, self._started = clock, False

    @property
    def camera(self) -> CameraHead:
        """The camera; ``CONFIG_INVALID`` when the scenario has none."""
        return self._plant_of(CameraHead, "camera")

    @property
    def inputs(self) -> InputPlant:
        """The input module; ``CONFIG_INVALID`` when the scenario has none."""
        return self._plant_of(InputPlant, "beams")

    @property
    def encoder(self) -> EncoderPlant:
        """The belt's encoder; ``CONFIG_INVALID`` when the scenario has none."""
        return self._plant_of(EncoderPlant, "belt")

    @property
    def observed(self) -> ObservedPlant:
        """The observed arm; ``CONFIG_INVALID`` when the scenario has none."""
        return self._plant_of(ObservedPlant, "palletizer")

    @property
    def tracker(self) -> TrackerPlant:
        """The laser tracker; ``CONFIG_INVALID`` when the scenario has none."""
        return self._plant_of(TrackerPlant, "tracker")

    def plant(self, device: str) -> Plant:
        """The physical device; ``CONFIG_INVALID`` when the scenario has none."""
        if device not in self.plants:
            raise error("CONFIG_INVALID", f"the scenario has no {device}")
        return self.plants[device]

    def _plant_of(self, kind: type[P], device: str) -> P:
        plant = self.plant(device)
        if not isinstance(plant, kind):
            raise error("CONFIG_INVALID", f"{device} of the scenario is no {kind.__name__}")
        return plant

    def start(self) -> None:
        """The first device was opened: the scenario's faults are scheduled from here."""
        if self._started:
            return
        self._started = True
        for fault in self.scenario.fault:
            asyncio.get_running_loop().call_later(fault.when_s, self.inject, fault)

    def inject(self, fault: FaultEntry) -> None:
        """Make ``fault`` happen now."""
        self.plant(fault.device).inject(fault.kind, fault.args)


_CELLS = "_object_cells"


def cell_of(scenario_path: str, clock: Clock) -> ObjectCell:
    """The object cell of a scenario (file, or name of a shipped one) on ``clock``; made at first use.

    A clock belongs to one run, so worlds of different runs never mix. It keeps them itself: in a dictionary
    beside it, however weak, each cell would keep its clock alive, and that the cell.
    """
    cells: dict[str, ObjectCell] = vars(clock).setdefault(_CELLS, {})
    if scenario_path not in cells:
        cells[scenario_path] = ObjectCell(Scenario.load(scenario_path), clock)
    return cells[scenario_path]


def world_of(scenario_path: str, clock: Clock) -> World:
    """The world that all object devices of this scenario and clock share."""
    return cell_of(scenario_path, clock).world
