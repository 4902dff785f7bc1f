"""A capture in memory: corners as the file has them, and each of them once."""

import json
from array import array
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import CellError
from cell.formats.pixel_list import PixelList, pixel_list
from procedures.hand_eye.solve.capture import load_capture
from tests.kit.hand_eye_scene import make_scene


def written(folder: Path, **changes: Any) -> Path:
    data = make_scene(2, count=6).data_set(**changes)
    seen = data["observations"][0]
    seen["corners"][3], seen["corners"][4] = None, [500, 300]
    framed = data["observations"][1]
    framed["frames"] = [{"corners": framed.pop("corners")}]
    path = folder / "capture.json"
    path.write_text(json.dumps(data), "utf-8")
    return path


def test_corners_are_those_of_the_file_whole_numbers_and_unseen_ones_too(tmp_path: Path) -> None:
    subject = load_capture(written(tmp_path))
    told = json.loads((tmp_path / "capture.json").read_text("utf-8"))["observations"]
    for k, observation in enumerate(told):
        corners = observation.get("corners") or observation["frames"][0]["corners"]
        view = subject.views[k]
        assert view is not None
        np.testing.assert_array_equal(view.corners, [c for c in corners if c is not None])


def test_corners_are_held_as_views_alone(tmp_path: Path) -> None:
    subject = load_capture(written(tmp_path))
    assert all(o.corners is None for o in subject.capture.observations)
    assert all(f.corners is None for o in subject.capture.observations for f in o.frames)
    assert len(subject.capture.observations[1].frames) == 1


def test_a_pixel_list_is_read_as_the_list_it_was_made_of() -> None:
    told = [[1.5, 2.0], None, [3, -4.25]]
    subject = pixel_list(told)
    assert isinstance(subject, PixelList)
    assert list(subject) == told
    assert subject[1:] == told[1:]
    assert subject[-1] == told[-1]
    assert repr(subject) == "[[1.5, 2.0], None, [3.0, -4.25]]"
    with pytest.raises(IndexError):
        subject[3]
    assert len(PixelList(array("d"))) == 0


@pytest.mark.parametrize(
    ("pixel", "text"),
    [
        ([1.0], "observations[2].corners[5] has 1 entries; it must have at least 2"),
        ([1.0, "x"], "observations[2].corners[5][1] should be a valid number"),
        ([1.0, 2e6], "observations[2].corners[5][1] is beyond 1e+06 px"),
        ([1.0, 10**400], "observations[2].corners[5][1] "),
        (7.0, "observations[2].corners[5] should be a valid list"),
    ],
)
def test_a_pixel_with_a_fault_is_named(tmp_path: Path, pixel: object, text: str) -> None:
    data = make_scene(2, count=6).data_set()
    data["observations"][2]["corners"][5] = pixel
    path = tmp_path / "capture.json"
    path.write_text(json.dumps(data), "utf-8")
    with pytest.raises(CellError) as raised:
        load_capture(path)
    assert text in raised.value.detail
