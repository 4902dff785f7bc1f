"""What is wrong in a data set of an insertion is refused by file and field."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cell.errors import InputError
from procedures.slot.data import read_data_set
from tests.unit.procedures.test_slot_setup import section

Q = [0.0, -1.57, 2.16, -2.16, -1.57, 0.0]


def data_set() -> dict[str, Any]:
    return {
        "schema": "cellward.slot/1",
        "job": json.loads(json.dumps(section(slot=1))),
        "robot": {"model": "ur10e"},
        "arm_rms_m": 1e-4,
        "hand_eye": {
            "T_flange_camera": [0.0, -0.08, 0.05, 0.0, 0.0, 0.0],
            "cov": [[1e-8 * (i == k) for i in range(6)] for k in range(6)],
            "budget": [{"block": "target", "t": 1e-4, "r": 1e-3}],
        },
        "T_flange_part": [0.0, 0.0, 0.26, 0.0, 0.0, 0.0],
        "look": {
            "what": "opening",
            "q": list(Q),
            "T_base_camera": [0.0] * 6,
            "T_base_slot": [0.0, 0.0, 0.3, 0.0, 0.0, 0.0],
            "sigma": [0.003] * 6,
            "colour": ["look.png"],
            "depth": [],
            "camera": {"width": 1280, "height": 800, "K": [800.0, 800.0, 640.0, 400.0], "dist": []},
            "reach_m": 0.012,
        },
        "insert_q": list(Q),
        "outcome": {"states": ["none"], "travel_m": 0.06, "force_n": 4.0, "reasons": []},
    }


def written(folder: Path, change: Callable[[dict[str, Any]], object] = lambda data: None) -> Path:
    data = data_set()
    change(data)
    (folder / "slot.json").write_text(json.dumps(data))
    return folder


def test_a_whole_data_set_is_read(tmp_path: Path) -> None:
    data, folder = read_data_set(written(tmp_path))
    assert folder == tmp_path
    assert data.look is not None
    assert data.look.look(folder).intrinsics.K == (800.0, 800.0, 640.0, 400.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d["T_flange_part"].__setitem__(2, 1e308), "T_flange_part[2] is beyond"),
        (lambda d: d["hand_eye"]["cov"][3].__setitem__(3, 1e308), "hand_eye.cov[3][3] is beyond"),
        (lambda d: d["hand_eye"]["budget"][0].update(t=1e308), "hand_eye.budget[0].t is beyond"),
        (lambda d: d["hand_eye"]["budget"][0].pop("block"), "hand_eye.budget[0].block is missing"),
        (lambda d: d["look"]["sigma"].__setitem__(0, -1e308), "look.sigma[0] is beyond"),
        (lambda d: d["look"]["camera"]["K"].__setitem__(0, 1e308), "look.camera.K[0] is beyond"),
        (lambda d: d["look"]["camera"].pop("K"), "look.camera.K is missing"),
        (lambda d: d["look"].update(reach_m=1e308), "look.reach_m is beyond"),
        (lambda d: d["insert_q"].__setitem__(5, 1e308), "insert_q[5] is beyond"),
        (lambda d: d.update(arm_rms_m=1e308), "arm_rms_m is beyond"),
        (lambda d: d["outcome"].update(force_n=1e308), "outcome.force_n is beyond"),
        (
            lambda d: d["job"]["rack"]["T_base_rack"].__setitem__(0, 1e308),
            "job: rack.T_base_rack[0] is",
        ),
        (lambda d: d["robot"].pop("model"), "robot"),
    ],
)
def test_what_no_cell_has_is_refused_by_file_and_field(
    tmp_path: Path, change: Callable[[dict[str, Any]], object], words: str
) -> None:
    with pytest.raises(InputError) as caught:
        read_data_set(written(tmp_path, change))
    assert "slot.json: " in caught.value.detail
    assert words in caught.value.detail
