"""The twins of the demo, one after the other: each with the steps that need its world, in its own folder."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from itertools import groupby
from pathlib import Path
from random import Random
from typing import Any

from cell.calibrations import time_offset
from cell.known_cell import KnownDelay
from cell.store.ledger import Ledger
from daemon.cli.output import say
from daemon.demo.steps import Step
from procedures.report.numbers import K95

OWN = "scenario.toml"
# Half of the interval of a camera's delay: latency-calibration leaves 0.1 ms on twins; three times that is an
# assumption for a cell.
DELAY_95_S = 0.0003
STORED_SET, OBSERVED_MODEL = "stored.json", "palletizer.json"


@dataclass(frozen=True)
class DemoScene:
    """Runs in one twin: ``twin`` names a shipped scenario, or one of the demo's own, ``twin``.toml."""

    twin: str
    steps: tuple[Step, ...]

    @property
    def given_camera(self) -> bool:
        """Whether a step counts on a calibrated camera over the belt."""
        return any(step.given_camera for step in self.steps)

    def prepare(self, folder: Path) -> str:
        """Put what the twin needs into ``folder``; returns the scenario as ``cellward-twin`` takes it."""
        own = files("daemon.demo").joinpath(f"{self.twin}.toml")
        if not own.is_file():
            return self.twin
        scenario = folder / OWN
        scenario.write_text(own.read_text("utf-8").replace("@FOLDER@", str(folder)), "utf-8")
        for name in (STORED_SET, OBSERVED_MODEL):
            with as_file(files("daemon.demo").joinpath(name)) as shipped:
                shutil.copyfile(shipped, folder / name)
        return str(scenario)


def scenes_of(steps: Sequence[Step]) -> list[DemoScene]:
    """The steps in their order, those of one twin together."""
    return [DemoScene(twin, tuple(group)) for twin, group in groupby(steps, key=lambda step: step.twin)]


def give_camera(ledger: Ledger, truth: Mapping[str, Any], drawn: Sequence[float] | None) -> None:
    """Commit the twin's own ``T_base_camera``, as an earlier eye-to-hand calibration would have; say so."""
    found = {"result": {"lens": truth["camera"]}}
    ledger.accept(ledger.propose("T_base_camera", truth["T_base_camera"], found, 0, drawn), "the demo")
    say("the fixed camera counts as calibrated before: the twin's own T_base_camera was committed")


def give_delay(ledger: Ledger, device: str, truth: Mapping[str, Any]) -> None:
    """Commit how late the twin's fixed camera ``device`` is as an earlier latency calibration would have: off
    by a draw of what it states; say so."""
    sigma = DELAY_95_S / K95
    against_arm = float(truth["camera"]["stamp_late_s"]) - float(truth["robot"]["stamp_late_s"])
    late = against_arm + sigma * Random(str(truth["camera"])).gauss(0.0, 1.0)
    _accept(ledger, device, KnownDelay(late, sigma))
    say(f"the delay of {device} counts as measured before, to {1e3 * DELAY_95_S:g} ms (95 %)")


def keep_delay(ledger: Ledger, device: str, delay: KnownDelay) -> None:
    """Commit the delay of ``device`` as the cell itself has measured it; say so."""
    _accept(ledger, device, delay)
    half_s = K95 * delay.sigma_s
    say(
        f"the delay of {device} is as the cell has measured it: {1e3 * delay.late_s:.2f} ms "
        f"+- {1e3 * half_s:.2f} ms (95 %)"
    )


def _accept(ledger: Ledger, device: str, delay: KnownDelay) -> None:
    half_s = K95 * delay.sigma_s
    found: dict[str, Any] = {"result": {"interval95_s": [delay.late_s - half_s, delay.late_s + half_s]}}
    if (part := delay.camera_sigma_s) is not None:  # by the camera's version of this ledger, or by no such
        version = ledger.effective(delay.camera, 0.0).version if part else 0
        found["inputs"] = {"camera_calibration": delay.camera, "camera_version": version}
        found["uncertainty"] = {"camera_sigma_s": part}
    ledger.accept(ledger.propose(time_offset(device), delay.late_s, found, 0, 0.0), "the demo")
