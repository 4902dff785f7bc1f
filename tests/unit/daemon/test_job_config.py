"""Parameters of a start are refused in plain words that name the parameter, the job and the fix."""

from pathlib import Path

import pytest

from cell.errors import CellError
from cell.procedure import Procedure
from daemon.job_config import make_procedure
from procedures.hand_eye.cone_capture import ConeCapture
from procedures.iso9283.procedure import Iso9283Test
from procedures.laser.check import LaserCheck
from procedures.laser.update import LaserUpdate
from procedures.latency.procedure import LatencyCalibration
from tests.kit.object_cell import write_config


def refusal(job: type, folder: Path, **params: str) -> CellError:
    with pytest.raises(CellError) as caught:
        make_procedure(job, write_config(folder), params)
    return caught.value


def test_an_unknown_parameter_gets_the_nearest_one_or_all(tmp_path: Path) -> None:
    found = refusal(ConeCapture, tmp_path, placement="1")
    assert (found.name, "did you mean 'placements'?" in str(found)) == ("ARGUMENT_INVALID", True)
    listed = str(refusal(ConeCapture, tmp_path, zzz="1"))
    assert "cone-capture has no parameter 'zzz'; it has " in listed
    assert "placements" in listed


def test_a_length_in_millimetres_is_refused_as_in_the_configuration(tmp_path: Path) -> None:
    found = str(refusal(ConeCapture, tmp_path, distance_m="500"))
    assert "distance_m: 500 m is probably millimetres; lengths are in metres" in found
    assert "Input should" not in found


def test_a_number_that_no_cell_has_is_refused_with_what_is_permitted(tmp_path: Path) -> None:
    found = str(refusal(LaserCheck, tmp_path, tolerance_m="1e308"))
    assert "tolerance_m: should be a finite number of at most 1e+300 in size, not 1e+308" in found


@pytest.mark.parametrize("job", [LaserCheck, LaserUpdate, LatencyCalibration])
def test_what_the_section_does_not_give_is_taken_from_that_of_the_reference(
    job: type[Procedure], tmp_path: Path
) -> None:
    config = write_config(tmp_path, "laser:ideal", jobs={"laser-reference": {"floor_m": 0.21}})
    assert make_procedure(job, config, {}).config.floor_m == 0.21
    assert make_procedure(job, config, {"floor_m": "0.25"}).config.floor_m == 0.25


def test_a_job_without_its_section_says_so(tmp_path: Path) -> None:
    found = refusal(Iso9283Test, tmp_path)
    assert found.name == "CONFIG_INVALID"
    assert "[job.iso9283] is not configured; cell.toml needs that section, with " in str(found)
    assert "reflector" in str(found)


def test_a_job_that_needs_no_section_takes_its_parameters(tmp_path: Path) -> None:
    made = make_procedure(LaserCheck, write_config(tmp_path), {"tolerance_m": "0.0005"})
    assert made.config.tolerance_m == 0.0005  # type: ignore[attr-defined]
