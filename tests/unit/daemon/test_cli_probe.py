"""The order in which ``cellward check --probe`` opens and closes devices that stand on each other."""

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from cell.devices import Identity
from cell.errors import error
from daemon.cli.probe import probe_devices
from daemon.supervisor import ExpectedIdentity


class Link:
    """A device that takes some turns of the loop to open (0: all of them), and cannot be asked before or
    afterwards."""

    def __init__(self, name: str, turns: int, stands_on: "Link | None" = None, fails: bool = False) -> None:
        self.name, self.turns, self.stands_on, self.fails = name, turns, stands_on, fails
        self.up = False

    async def open(self) -> None:
        if self.stands_on is not None:
            await self.stands_on.identify()
        for _ in range(self.turns or 10**9):
            await asyncio.sleep(0)
        if self.fails:
            raise error("DEVICE_UNREACHABLE", f"{self.name} is off")
        self.up = True

    async def identify(self) -> Identity:
        if not self.up:
            raise error("DEVICE_LOST", f"{self.name} is still connecting")
        if self.stands_on is not None:
            await self.stands_on.identify()
        return Identity("x", "99990000001")

    async def close(self) -> None:
        self.up = False


@pytest.mark.parametrize("first", ["arm", "gripper"])
@pytest.mark.parametrize(
    ("turns", "fails", "answers"),
    [
        (20, False, ("ok", "ok")),
        (20, True, ("arm is off", "arm is still connecting")),
        (0, False, ("no answer in", "arm is still connecting")),
    ],
)
def test_a_gripper_on_an_arm_is_asked_while_the_arm_is_open(
    monkeypatch: pytest.MonkeyPatch, first: str, turns: int, fails: bool, answers: tuple[str, str]
) -> None:
    monkeypatch.setattr("daemon.cli.probe.OPEN_TIMEOUT_S", 0.2 if turns == 0 else 20.0)
    arm = Link("arm", turns, fails=fails)
    gripper = Link("gripper", 40, arm)
    links = [arm, gripper] if first == "arm" else [gripper, arm]
    expect = ExpectedIdentity(twin=True)
    entries = [SimpleNamespace(device=link, expect=expect) for link in links]
    monkeypatch.setattr("daemon.cli.probe.supervised_devices", lambda *_: entries)
    sections = {
        "arm": SimpleNamespace(driver="ur"),
        "gripper": SimpleNamespace(driver="arm-gripper", arm="arm"),
    }
    config: Any = SimpleNamespace(device=sections, robot=SimpleNamespace(roles=dict))
    found = {report["device"]: report["answer"] for report in asyncio.run(probe_devices(config))}
    assert answers[0] in found["arm"]
    assert answers[1] in found["gripper"]
    assert (arm.up, gripper.up) == (False, False)
