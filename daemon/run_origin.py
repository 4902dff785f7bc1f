"""What a record must say to be believed later: which software ran, on which configuration, at whose wish."""

import platform
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from daemon.config import CellConfig
from daemon.start_request import StartRequest

NAMED = ("cellward", "numpy", "scipy", "opencv-contrib-python-headless")  # what the figures hang on


def origin(config: CellConfig, request: StartRequest) -> dict[str, Any]:
    """For ``run.json``: ``versions``, ``config_digest`` (SHA-256) and ``started_by``. It reads the disk."""
    return {
        "versions": dict(versions()),
        "config_digest": config.digest,
        "started_by": {"who": request.who, "channel": request.channel},
    }


@cache
def versions() -> Mapping[str, str]:
    """The version of this software, of Python, and of the libraries that the figures hang on."""
    return {"python": platform.python_version(), **{name: _version(name) for name in NAMED}}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:  # run from a folder that nobody installed
        return "unknown"
