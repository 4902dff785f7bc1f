"""The limits of trends: each is a key that every job of its kind has, a length or a time of its own."""

import pytest
from pydantic import BaseModel

from procedures.kind import KINDS, load

LIMITS = [
    (reference, trend, key)
    for kind in KINDS.values()
    for reference in kind.jobs
    for trend, key in kind.trend_limits
]


@pytest.mark.parametrize(("reference", "trend", "key"), LIMITS)
def test_the_limit_of_a_trend_is_a_key_of_the_jobs_that_leave_it(
    reference: str, trend: str, key: str
) -> None:
    model: type[BaseModel] = load(reference).Config
    *tables, last = key.split(".")
    for table in tables:
        inner = model.model_fields[table].annotation
        assert isinstance(inner, type)
        assert issubclass(inner, BaseModel)
        model = inner
    assert last in model.model_fields
    assert last.rpartition("_")[2] == trend.rpartition("_")[2]  # one unit


def test_no_trend_is_bounded_twice_by_one_kind() -> None:
    assert len({(reference, trend) for reference, trend, _ in LIMITS}) == len(LIMITS)
