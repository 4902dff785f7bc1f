"""Units and tables for people's eyes: millimetres, degrees and aligned columns, each with its unit."""

from collections.abc import Iterable, Sequence
from datetime import datetime
from math import degrees, sqrt
from typing import Any


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Aligned columns; numbers are to be given as text with their unit in the header."""
    lines = [list(header), *([("-" if cell is None else str(cell)) for cell in row] for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    return "\n".join(
        "  ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)).rstrip() for line in lines
    )


def told(value: object, spec: str = "") -> str:
    """A figure or a name for people; what a document does not say is unknown, never ``None``."""
    return "unknown" if value is None else format(value, spec)


def listed(names: Sequence[str]) -> str:
    """``arm, lens and target``."""
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


def mm(metres: float | None, digits: int = 3) -> str:
    """A length for people."""
    return "unknown" if metres is None else f"{1e3 * metres:.{digits}f} mm"


def deg(radians: float | None, digits: int = 4) -> str:
    """An angle for people."""
    return "unknown" if radians is None else f"{degrees(radians):.{digits}f} deg"


def ms(seconds: float | None, digits: int = 2) -> str:
    """A short time for people."""
    return "unknown" if seconds is None else f"{1e3 * seconds:.{digits}f} ms"


def pose_text(pose: Sequence[float]) -> str:
    """``[x, y, z, rx, ry, rz]`` for people: millimetres, and the rotation vector in degrees."""
    t = ", ".join(f"{1e3 * v:.3f}" for v in pose[:3])
    r = ", ".join(f"{degrees(v):.4f}" for v in pose[3:])
    return f"[{t}] mm, rotation vector [{r}] deg"


def local_time(stamp: str | float | None) -> str:
    """An ISO stamp or seconds since 1970 as local time to the second."""
    if stamp is None:
        return "-"
    moment = datetime.fromisoformat(stamp) if isinstance(stamp, str) else datetime.fromtimestamp(stamp)
    return f"{moment.astimezone():%Y-%m-%d %H:%M:%S}"


def sigma_text(cov: Sequence[Sequence[float]]) -> str:
    """One standard deviation of each component of a pose covariance (6, 6), translation first."""
    sigma = [sqrt(max(cov[i][i], 0.0)) for i in range(6)]
    t = ", ".join(f"{1e3 * s:.4f}" for s in sigma[:3])
    r = ", ".join(f"{degrees(s):.5f}" for s in sigma[3:])
    return f"x, y, z {t} mm; about x, y, z {r} deg"
