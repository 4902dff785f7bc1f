"""The files of the page: a fixed table in memory, so that no path of a request ever reaches the disk."""

import hashlib
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable

TYPES = {
    "html": "text/html",
    "css": "text/css",
    "js": "text/javascript",
    "txt": "text/plain",
    "json": "application/json",
    "svg": "image/svg+xml",
}


@dataclass(frozen=True)
class PageFile:
    """One file as it is sent."""

    content: bytes
    type: str
    etag: str


def page_files() -> dict[str, PageFile]:
    """Every file below ``static`` by its path there. Blocks on the disk."""
    return dict(_below(files("daemon.web").joinpath("static"), ""))


def _below(folder: Traversable, prefix: str) -> list[tuple[str, PageFile]]:
    found = []
    for entry in folder.iterdir():
        kind = entry.name.rpartition(".")[2]
        if entry.is_dir():
            found += _below(entry, f"{prefix}{entry.name}/")
        elif kind in TYPES:
            content = entry.read_bytes()
            etag = hashlib.sha256(content).hexdigest()[:32]
            found.append((f"{prefix}{entry.name}", PageFile(content, TYPES[kind], etag)))
    return found
