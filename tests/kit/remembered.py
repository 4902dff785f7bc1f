"""Plans and predictions, made once for all who ask for the same: both have tests of their own."""

import copy
import json
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import cache, wraps
from typing import Any, TypeVar

import pytest

from calibration.tool_frame import prediction

Request = TypeVar("Request")
Plan = TypeVar("Plan")

_SMALL = 1e-3  # standard deviations and the like


def remembered(
    plan: Callable[[Request], Plan], alike: Callable[[Request], Request] = lambda request: request
) -> Callable[[Request], Plan]:
    """``plan``, which is pure, asked once for requests that are alike; whoever asks has a copy to himself.

    ``alike`` leaves of a request what tells it from others.
    """
    known: dict[str, Plan] = {}

    @wraps(plan)
    def asked(request: Request) -> Plan:
        key = _key(alike(request))
        if key not in known:
            known[key] = plan(request)
        return copy.deepcopy(known[key])

    return asked


def _key(request: Any) -> str:
    """The request in words, less the versions of what it was made with."""
    values = replace(request.values, configured={}, versions={})
    text = json.dumps(asdict(replace(request, values=values)), sort_keys=True, default=_plain)
    return json.dumps(json.loads(text, parse_float=_rounded))


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else sorted(value)


def _rounded(digits: str) -> float:
    """Arms that stand alike to a microradian have one plan."""
    value = float(digits)
    return round(value, 6) if abs(value) >= _SMALL else float(f"{value:.4g}")


@cache
def predicted_roughly(*given: Any, **how: Any) -> prediction.ExpectedComparison:
    """What :func:`calibration.tool_frame.prediction.predict` expects, from one draw instead of its ten."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prediction, "_DRAWS", 1)
        return prediction.predict.__wrapped__(*given, **how)
