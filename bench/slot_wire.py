"""Insertions on the wire in real time: twin and daemon as processes, the slot's number from a PLC.

``python -m bench.slot_wire [RUNS] [--bind 127.0.53.3] [--first SEED]``: the scenario slot with a rack of 12
slots, of which the second is occupied, and a feeder that offers the next part at the same place, each a
little off as a gripper takes it. A client that is not ours (pyModbusTCP) gives the job with the slot as its
first argument and reads how it ended. A row for each insertion: how far the part truly is beside the middle
of the slot, and what was predicted to 95 %. A run that ends because this machine was late is told, reset,
and tried once more; the camera gives two pictures a second, because they are drawn on the cores of the job.
"""

import argparse
import sys
import tempfile
import time
from contextlib import closing
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from pyModbusTCP.client import ModbusClient

from cell.poses import exp_xi, from_pose6, to_pose6
from cell.store.ledger import Ledger
from cell.store.runs import load_run
from fakes.twin.control import ask
from fakes.world.scenario import Scenario
from fakes.world.toml_text import to_toml
from tests.kit.slot_cell import BUDGET, HAND_EYE_COV, SLOT
from tests.kit.wire_cell import PATIENT, WireCell, pause, wait_for

PART_SIGMA = np.repeat([1e-4, 1e-3], 3)  # m, rad; as the job has it by default
OCCUPIED, ROWS, COLUMNS = 2, 3, 4
SLOTS = ROWS * COLUMNS
START, RESET, JOB = 1, 7, 9
READY, BUSY = 1 << 0, 1 << 1
NEEDED = READY | 1 << 7 | 1 << 8  # arm and camera
LONGEST_S = 240.0
ATTEMPTS = 2
LIMITS = PATIENT | {"oak": {"frame_timeout_s": 10.0}}
HEAD = f"{'slot':>5}  {'part':<10}{'beside mm':>10}{'95 % mm':>9}{'inside':>8}{'took s':>8}{'again':>7}"


def scenario(parts: int, seed: int) -> str:
    """The scenario with a larger rack and a feeder; the parts scatter as the job is told that they do."""
    text = files("fakes").joinpath("scenarios", "slot.toml").read_text("utf-8")
    tables = Scenario.parse(text).model_dump(by_alias=True, exclude_none=True)
    rack, rng = tables["world"]["rack"], np.random.default_rng([seed, 0x510])
    place = from_pose6(rack["parts"][0]["T_base_part"])
    fed = [place * exp_xi(PART_SIGMA * rng.normal(size=6)) for _ in range(parts)]
    rack["parts"] = [{"T_base_part": to_pose6(T).tolist()} for T in fed] + [{"slot": OCCUPIED}]
    tables["world"]["camera"]["period_s"] = 0.5
    for table in (rack, tables["cell"]["job"][SLOT]["rack"]):
        table |= {"rows": ROWS, "columns": COLUMNS}
    return to_toml(tables)


def give_hand_eye(cell: WireCell, seed: int) -> None:
    """Commit a lens, and a camera's pose off by a draw of its stated covariance; before the daemon starts."""
    config, rng = cell.config(), np.random.default_rng([seed, 0xE7E])
    truth = ask(cell.folder, {"do": "truth"})
    true = from_pose6(truth["T_flange_camera"])
    told = to_pose6(true * exp_xi(rng.multivariate_normal(np.zeros(6), HAND_EYE_COV))).tolist()
    answer = {"T_flange_camera": told, "cov": HAND_EYE_COV.tolist(), "budget": BUDGET}
    answer["lens"] = {key: truth["camera"][key] for key in ("width", "height", "K", "dist")} | {"rms_px": 0.1}
    state = Path(config["cell"]["state_dir"])
    state.mkdir(mode=0o700, parents=True, exist_ok=True)
    with closing(Ledger(state / "ledger.sqlite")) as ledger:
        drawn = config["robot"]["T_flange_camera_nominal"]
        ledger.accept(ledger.propose("T_flange_camera", told, {"result": answer}, 0, drawn), "bench")


class Plc:
    """A PLC's program on pyModbusTCP: it knows the register table and nothing else of ours."""

    def __init__(self, bind: str) -> None:
        host, _, port = bind.rpartition(":")
        self._client = ModbusClient(host, int(port), timeout=5.0)
        self._beat = 0

    def insert(self, slot: int) -> list[int]:
        """Start the insertion and wait for its end; the status block then."""
        self._until(lambda words: words[0] & NEEDED == NEEDED, LONGEST_S)
        self._command(START, JOB, 0, 0, slot, 0, 1, 0, 0)  # action 1: insert
        return self._until(lambda words: not words[0] & BUSY, LONGEST_S)

    def reset(self) -> None:
        """Leave a fault."""
        self._command(RESET)

    def _command(self, code: int, *behind: int) -> None:
        sequence = self._read()[1] % 0xFFFF + 1
        if not self._client.write_multiple_registers(0, [code, sequence, *behind]):
            raise RuntimeError(f"writing the command: {self._client.last_error_as_txt}")
        self._until(lambda words: words[1] == sequence, 20.0)
        if (result := self._read()[2]) >= 0x8000:
            raise RuntimeError(f"command {code} was refused with {result - 0x8000}")

    def _until(self, true: Any, limit_s: float) -> list[int]:
        give_up = time.monotonic() + limit_s
        while not true(words := self._read()):
            if time.monotonic() > give_up:
                raise TimeoutError(f"not within {limit_s:g} s: {words}")
            pause(0.1)
        return words

    def _read(self) -> list[int]:
        self._beat = (self._beat + 1) & 0xFFFF
        self._client.write_multiple_registers(10, [self._beat, 1])
        words = self._client.read_input_registers(0, 64)
        if words is None:
            raise RuntimeError(f"reading the status: {self._client.last_error_as_txt}")
        return list(words)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="?", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="seed of what scatters")
    parser.add_argument("--bind", default="127.0.53.3")
    options = parser.parse_args()
    slots = [n for n in range(1, SLOTS + 1) if n != OCCUPIED][: options.runs]
    print(HEAD)
    good, inside, late = [], [], 0
    with tempfile.TemporaryDirectory() as folder:
        cell = WireCell(Path(folder), options.bind, scenario(len(slots), options.first), LIMITS)
        try:
            cell.start_twin()
            give_hand_eye(cell, options.first)
            cell.start_daemon()
            plc = Plc(cell.config()["modbus"]["bind"])
            wait_for(cell.ready, "ready devices", 60.0)
            ask(cell.folder, {"do": "operator", "remove": True})  # the board, which would cover the rack
            for slot in slots:
                began = time.monotonic()
                for left in reversed(range(ATTEMPTS)):
                    row = judged(cell, plc.insert(slot), slot)
                    if row["part"] != "aborted" or not left:
                        break
                    late += 1
                    print(f"{slot:5}  ended, and tried again: {row['why']}", flush=True)
                    plc.reset()
                off, predicted, part = row["off"], row["predicted"], row["part"]
                good.append(part == "released")
                inside.append(off is not None and off <= predicted)
                shown = f"{'-':>10}" if off is None else f"{1e3 * off:10.3f}"
                print(
                    f"{slot:5}  {part:<10}{shown}{1e3 * predicted:9.3f}"
                    f"{'yes' if inside[-1] else 'NO':>8}{time.monotonic() - began:8.1f}{row['again']:7}"
                    + (f"  {row['why']}" if row["why"] else ""),
                    flush=True,
                )
            met = ask(cell.folder, {"do": "truth"})["rack"]["on_face"]
        finally:
            cell.stop()
    print(
        f"{len(slots)} insertions: {len(met)} collisions, {sum(good)} inserted; the prediction held in "
        f"{sum(inside)} of {len(slots)}; {late} runs were ended by this machine and tried again"
    )
    return 0 if all(good) and not met else 1


def judged(cell: WireCell, words: list[int], slot: int) -> dict[str, Any]:
    """What a run states, beside where the part truly is (``off``, m; None when none is in the slot)."""
    number = words[10] << 16 | words[11]
    run = load_run(Path(cell.config()["cell"]["state_dir"]) / "runs", number)
    end, result = run.read_end() or {}, run.read_result() or {}
    answer = result.get("result") or {}
    rack = ask(cell.folder, {"do": "truth"})["rack"]
    part = rack["in_slot"][str(slot)]
    off = None
    if part is not None:
        T = from_pose6(rack["slots"][slot - 1]).inv() * from_pose6(rack["parts"][part])
        off = float(np.linalg.norm(T.translation[:2]))
    failure = (end.get("error") or {}).get("text", "")
    if answer and answer["slot"] != slot:
        failure = f"slot {answer['slot']} was worked on"
    return {
        "part": answer.get("part", end.get("outcome", "?")),
        "predicted": (answer.get("budget") or {}).get("at_end_m", 0.0),
        "off": off,
        "why": failure or "; ".join(result.get("reasons") or []),
        "again": (cell.status()["last_run"] or {}).get("steps_taken_again", 0),
    }


if __name__ == "__main__":
    sys.exit(main())
