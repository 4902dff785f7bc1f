"""The examples of measuring programs in the docs: each section's configuration reads its sample."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from drivers.tracker import LineStreamConfig
from drivers.tracker.line_parser import BadLine, LineParser, Parsed

DOCS = Path(__file__).parents[3] / "docs"
SECTIONS = re.findall(
    r"^## (.+?)$.*?\((examples/tracker/.+?)\).*?^```toml\n(.*?)^```",
    (DOCS / "tracker-lines.md").read_text(),
    re.M | re.S,
)
PLACES = [
    (2.1034512, -0.4512083, 0.3320147),
    (2.2511904, 0.1200456, 0.5518832),
    (1.9023377, 0.3309921, 0.2100584),
]


def read(sample: str, section: str, **other: object) -> list[Parsed]:
    keys = {**tomllib.loads(section)["device"]["tracker"], **other}
    subject = LineParser(LineStreamConfig.model_validate({k: v for k, v in keys.items() if k != "driver"}))
    lines = (DOCS / sample).read_bytes().splitlines()
    return [parsed for line in lines if (parsed := subject.parse(line)) is not None]


def test_there_are_three_programs_and_every_sample_belongs_to_one() -> None:
    assert len(SECTIONS) == 3
    samples = {path.relative_to(DOCS).as_posix() for path in (DOCS / "examples/tracker").iterdir()}
    assert samples == {sample for _, sample, _ in SECTIONS}


@pytest.mark.parametrize(("name", "sample", "section"), SECTIONS, ids=[name for name, _, _ in SECTIONS])
def test_the_sample_of_a_program_gives_the_points_that_it_was_made_of(
    name: str, sample: str, section: str
) -> None:
    points = [parsed.point for parsed in read(sample, section) if parsed.point is not None]
    np.testing.assert_allclose(points, PLACES, atol=2e-7)


def test_a_point_that_the_program_calls_bad_is_none() -> None:
    _, sample, section = SECTIONS[1]
    bad = [parsed.status for parsed in read(sample, section) if parsed.point is None]
    assert bad == ["the sender says 'Strahl unterbrochen'"]


def test_the_air_comes_in_pascal_and_millibars_are_not_taken_for_them() -> None:
    _, sample, section = SECTIONS[2]
    assert {(parsed.temperature_c, parsed.pressure_pa) for parsed in read(sample, section)} == {
        (20.4, 101800.0)
    }
    columns = {"hz": 2, "v": 3, "range": 4, "pressure_pa": 7}
    with pytest.raises(BadLine, match=r"1018 Pa is no pressure of air.* pressure_unit in cell\.toml"):
        read(sample, section, columns=columns, pressure_unit=None)
