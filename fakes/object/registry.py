"""One world for all devices of an object cell: found by scenario and clock."""

import asyncio
from weakref import WeakKeyDictionary

from cell.clock import Clock
from fakes.object.controller import Controller
from fakes.object.head import CameraHead
from fakes.scenario import FaultEntry, Scenario
from fakes.world import World


class ObjectCell:
    """The physical side: world, robot controller, camera, and the scenario's faults."""

    def __init__(self, scenario: Scenario, clock: Clock) -> None:
        self.scenario = scenario
        self.world = World.from_scenario(scenario, clock.now())
        self.controller = Controller(self.world, clock)
        self.camera = CameraHead(self.world, clock)
        self._clock, self._started = clock, False

    def start(self) -> None:
        """The first device was opened: the scenario's faults are scheduled from here."""
        if self._started:
            return
        self._started = True
        for fault in self.scenario.fault:
            asyncio.get_running_loop().call_later(fault.when_s, self.inject, fault)

    def inject(self, fault: FaultEntry) -> None:
        """Make ``fault`` happen now."""
        plant = self.controller if fault.device == "arm" else self.camera
        plant.inject(fault.kind, fault.args)


# A clock belongs to one run, so worlds of different runs never mix and go with their clock.
_cells: WeakKeyDictionary[Clock, dict[str, ObjectCell]] = WeakKeyDictionary()


def cell_of(scenario_path: str, clock: Clock) -> ObjectCell:
    """The object cell of a scenario (file, or name of a shipped one) on ``clock``; made at first use."""
    cells = _cells.setdefault(clock, {})
    if scenario_path not in cells:
        cells[scenario_path] = ObjectCell(Scenario.load(scenario_path), clock)
    return cells[scenario_path]


def world_of(scenario_path: str, clock: Clock) -> World:
    """The world that all object devices of this scenario and clock share."""
    return cell_of(scenario_path, clock).world
