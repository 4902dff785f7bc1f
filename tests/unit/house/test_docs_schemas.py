"""Every schema that the code writes or reads is in the docs, and none that it does not know."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[3]
PACKAGES = ("cell", "calibration", "procedures", "drivers", "daemon", "fakes")
SCHEMA = re.compile(r"cellward\.[a-z0-9-]+/[0-9]+")


def schemas(text: str) -> set[str]:
    return set(SCHEMA.findall(text))


def test_the_docs_list_every_schema_of_the_code() -> None:
    written = set[str]()
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            written |= schemas(path.read_text("utf-8"))
    listed = schemas((ROOT / "docs" / "data-sets.md").read_text("utf-8").split("# All schemas")[1])
    assert len(written) > 15
    assert listed == written
