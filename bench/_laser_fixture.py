"""Scenarios of crossed beams with another arm, another end of the tool, and beams somewhere else."""

from itertools import pairwise

import numpy as np

from fakes.likely.arm import LEAN_RAD
from tests.kit.ideal_world import ideal_text, shipped_text

RIM, THIN_M, PIN_M = 16, 5e-5, 0.003
HEIGHT_M = 2.5e-3  # the beams are up to so much higher or lower


def scenario(kind: str, sigma_m: float, seed: int, ideal: bool = False) -> str:
    """The shipped scenario, or its ideal world. ``kind`` is round or flat, ``sigma_m`` the arm's standard
    deviation of one axis; the beams' heights and how the tool leans are drawn from ``seed``."""
    rng = np.random.default_rng([seed, 5])
    low = 0.25 + rng.uniform(-HEIGHT_M, HEIGHT_M)
    text = (ideal_text if ideal else shipped_text)("laser")
    text = _with(text, "seed = 20260", f"seed = {seed + 1}")
    text = _with(text, "repeatability_t_m = 0.0000139", f"repeatability_t_m = {sigma_m:.7f}")
    text = _with(text, "[-0.45, 0.45, 0.25]", f"[-0.45, 0.45, {low:.7f}]")
    text = _with(text, "[-0.45, 0.45, 0.2503]", f"[-0.45, 0.45, {low + rng.uniform(0.0, 4e-4):.7f}]")
    if not ideal:
        x, y = LEAN_RAD * rng.standard_normal(2)
        text = _with(text, "lean_rad = [0.0015, -0.001]", f"lean_rad = [{x:.7f}, {y:.7f}]")
    if kind == "flat":
        begin = text.index("shape = [")
        text = text[:begin] + f"shape = [{', '.join(_flat_end())}]" + text[text.index("\n", begin) :]
    return text


def _with(text: str, old: str, new: str) -> str:
    if old not in text:
        raise LookupError(f"the shipped scenario has no '{old}' any more")
    return text.replace(old, new, 1)


def _flat_end() -> list[str]:
    """A rim of thin capsules in a plane, and the body above it."""
    angle = np.linspace(0.0, 2.0 * np.pi, RIM + 1)
    r = PIN_M - THIN_M
    rim = np.round(np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(RIM + 1, -THIN_M)]), 9)
    body = (rim[0] * 0.0 + [0.0, 0.0, -PIN_M], np.array([0.0, 0.0, -0.057]), PIN_M)
    parts = [body, *((a, b, THIN_M) for a, b in pairwise(rim))]
    return [f"{{ from = {a.tolist()}, to = {b.tolist()}, radius_m = {radius} }}" for a, b, radius in parts]
