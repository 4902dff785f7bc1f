"""What the matrices of faults share: kinds of faults, which states each is struck at, and how.

The whole product of kinds and states is for the long runs. The suite takes the subset of :func:`covering`:
each kind of fault at least once, each state at least once, by a fixed rule.

A kind of fault strikes run after run in one cell, each time at another state; that the next run gets as far
as the state it is struck in shows that the one before left nothing behind.
"""

import asyncio
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import pytest

from cell.procedure import Run
from tests.kit.object_cell import WHO, ObjectCell

BRISK = {  # limits of the arm with which a run goes fast
    "speed_m_s": 1.0,
    "accel_m_s2": 5.0,
    "joint_speed_rad_s": 3.0,
    "joint_accel_rad_s2": 20.0,
    "workspace": [{"min": [-1.3, -1.3, 0.0], "max": [1.3, 1.3, 1.8]}],
}


@dataclass(frozen=True)
class Kind:
    """A fault, the errors that may come of it, and the moments at which it can be felt at all.

    ``bridged``: moments at which it costs a step at most, and the run completes.
    """

    device: str
    fault: str
    errors: frozenset[str]
    felt: set[str]
    arguments: dict[str, Any] = field(default_factory=dict)
    bridged: set[str] = field(default_factory=set)

    @property
    def label(self) -> str:
        return " ".join([self.device, self.fault, *(str(v) for v in self.arguments.values())])


def kind(device: str, fault: str, errors: str, felt: set[str], **arguments: Any) -> Kind:
    return Kind(device, fault, frozenset(errors.split()), felt, arguments)


def short(device: str, fault: str, bridged: set[str], **arguments: Any) -> Kind:
    """A fault that is over before a run ends for it: a step is taken again."""
    return Kind(device, fault, frozenset(), set(), arguments, bridged)


Strike = tuple[Kind, str]


def covering(
    kinds: Sequence[Kind], moments: Sequence[str], needed: Collection[str] | None = None
) -> list[list[str]]:
    """The moments at which each kind strikes: every kind at one, and all those ``needed`` are met.

    By default all are needed.

    The rule: the kinds that can be felt at fewest moments choose first, and each takes the moment that fewest
    have taken so far, among those at which it can be felt (among all, if it is felt nowhere). A needed moment
    that nobody took goes to the kind with fewest moments, if possible to one that can be felt there.
    """
    shares: list[list[str]] = [[] for _ in kinds]
    met = dict.fromkeys(moments, 0)

    def take(number: int, moment: str) -> None:
        shares[number].append(moment)
        met[moment] += 1

    def felt(number: int) -> list[str]:
        return [m for m in moments if m in kinds[number].felt | kinds[number].bridged]

    for number in sorted(range(len(kinds)), key=lambda n: len(felt(n) or moments)):
        take(number, min(felt(number) or moments, key=lambda m: met[m]))
    for moment in moments if needed is None else needed:
        if not met[moment]:
            take(min(range(len(kinds)), key=lambda n: (moment not in felt(n), len(shares[n]))), moment)
    return shares


def in_cells(kinds: Sequence[Kind], shares: Sequence[Sequence[str]], each: int) -> list[Any]:
    """Parameters: so many kinds strike in one cell, one after the other, each at the moments of its share."""
    paired = list(zip(kinds, shares, strict=True))
    groups = [paired[i : i + each] for i in range(0, len(paired), each)]
    return [
        pytest.param([(k, m) for k, share in group for m in share], id=", ".join(k.label for k, _ in group))
        for group in groups
    ]


def inject_at(
    cell: ObjectCell,
    fault: Kind,
    moment: str,
    after_s: float = 0.0,
    here: Callable[[Run], bool] | None = None,
) -> list[str]:
    """Strike once, ``after_s`` after the job is at ``moment`` (or ``here`` says so); the list holds the state
    when it did."""
    plant, struck = cell.plant.plants[fault.device], list[str]()
    loop = asyncio.get_running_loop()

    def look() -> None:
        run = cell.engine.run
        if struck or not cell.engine.active or run is None or run.state is None:
            return
        if here(run) if here is not None else run.state.value == moment:
            struck.append(run.state.value)
            strike = partial(plant.inject, fault.fault, fault.arguments)
            loop.call_later(after_s, strike) if after_s else strike()

    cell.engine.subscribe(look)
    return struck


def assert_aborted(end: dict[str, Any], fault: Kind, where: str) -> None:
    """The run ended by the name of what struck it."""
    assert end["error"] is not None, f"{end['outcome']} in spite of {where}"
    assert (end["outcome"], end["packml"]) == ("aborted", "ABORTED"), where
    assert end["error"]["name"] in fault.errors, (where, end["error"])


async def put_right(cell: ObjectCell) -> None:
    """What a person does: correct the cause, wait for the devices, reset."""
    for plant in cell.plant.plants.values():
        plant.clear()
    await cell.until(cell.all_ready, "all devices back", 30.0)
    await cell.clock.sleep(0.1)  # until the stream shows it
    await cell.engine.reset(WHO)
