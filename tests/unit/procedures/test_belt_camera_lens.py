"""Which lens a belt's camera is used with, by what the calibration of its pose found, and how sure it is."""

from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calibration.adjustment.lens_terms import lens_prior
from cell.devices import Intrinsics
from cell.store.ledger import Ledger
from daemon.values import resolve_values
from procedures.belt.camera_to_belt import CameraToBelt
from procedures.belt.config import ItemLook
from tests.kit.picking_cell import picking_config

TOLD = Intrinsics(1280, 800, (800.0, 800.0, 640.0, 400.0), (0.0,) * 5)
FOUND = {"width": 1280, "height": 800, "K": [802.0, 801.0, 643.0, 396.0], "dist": [0.02, 0.0, 0.0, 0.0, 0.0]}
COV, WITH_LENS = (1e-8 * np.eye(6)).tolist(), (1e-7 * np.eye(14)).tolist()
SIGMA = {"f": 0.01}


@pytest.mark.parametrize(
    ("result", "lens", "of_lens"),
    [
        ({"lens": FOUND, "cov": COV, "budget": [], "lens_cov": WITH_LENS}, FOUND, [1e-7**0.5] * 8),
        ({"lens": FOUND, "cov": COV, "budget": []}, FOUND, [0.0] * 8),
        ({"intrinsics": FOUND, "cov": COV}, FOUND, None),  # takes the arm as exact: stated far too little
        (
            {"lens": {**FOUND, "width": 640}, "cov": COV, "lens_cov": WITH_LENS},
            None,
            lens_prior(SIGMA).sigma(),
        ),
        ({"cov": COV}, None, lens_prior(SIGMA).sigma()),
        ({}, None, None),
    ],
    ids=["with the pose", "of before", "estimated", "of other pictures", "without", "committed by hand"],
)
def test_a_lens_is_that_of_the_pose_or_known_as_told(
    tmp_path: Path, result: dict[str, Any], lens: dict[str, Any] | None, of_lens: Any
) -> None:
    config, supervisor = picking_config(tmp_path), SimpleNamespace(devices={})
    drawn = config.robot.T_base_camera_nominal
    with closing(Ledger(tmp_path / "ledger.sqlite")) as ledger:
        ledger.accept(ledger.propose("T_base_camera", drawn, {"result": result}, 1, drawn), "test")
        values = resolve_values(config, ledger, supervisor, ("arm", "fixed_camera"), None)
    subject = CameraToBelt(values, 0.1, ItemLook.model_validate({"camera_sigma": SIGMA}))
    kept = subject.camera(TOLD)
    used = kept["lens"] and {**kept["lens"], **{key: list(kept["lens"][key]) for key in ("K", "dist")}}
    assert used == lens
    assert kept["told"] == {**asdict(TOLD), "sigma": SIGMA}
    assert subject.spec()["lens"] == result.get("lens", result.get("intrinsics"))
    if of_lens is None:
        assert kept["cov"] is None
    else:
        assert np.sqrt(np.diag(kept["cov"])[6:]) == pytest.approx(list(of_lens))
