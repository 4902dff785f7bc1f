"""Is the record of a run what it was? Its files, the signatures, and the answer solved again."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cell.errors import CellError
from cell.store.bundle import DAMAGED, unpack_bundle
from cell.store.files import read_json
from cell.store.fingerprint import BUNDLE_FILE, SUMS_FILE, Fingerprint, fingerprint
from cell.store.runs import RunFolder, load_run
from cell.store.signatures import Signature, fault_of, read_signatures
from daemon.cli.replay import differences
from procedures.replay import solve_again


@dataclass
class Verified:
    """``altered``: files that are not as listed or signed, in words; ``differences``: of the answer solved
    again; ``unsolved``: why it could not be. ``signatures``: each with what is wrong with it, or nothing."""

    run_id: int
    job: str
    digest: str
    files: int
    altered: list[str] = field(default_factory=list)
    signatures: list[tuple[Signature, str]] = field(default_factory=list)
    differences: list[dict[str, Any]] = field(default_factory=list)
    unsolved: str = ""

    @property
    def good(self) -> bool:
        """Nothing was altered, every signature is for these files, and the answer is the same."""
        wrong = [why for _, why in self.signatures if why]
        return not (self.altered or wrong or self.differences)

    def as_dict(self) -> dict[str, Any]:
        """For programs."""
        signed = [
            {"name": s.name, "role": s.role, "at": s.at, "digest": s.digest, "wrong": why or None}
            for s, why in self.signatures
        ]
        return {
            "run_id": self.run_id,
            "job": self.job,
            "good": self.good,
            "digest": self.digest,
            "files": self.files,
            "altered": self.altered,
            "signatures": signed,
            "solved_again": not self.unsolved,
            "unsolved": self.unsolved or None,
            "differences": self.differences,
        }


def verify_run(run: RunFolder, audit: Sequence[Mapping[str, Any]] | None = None) -> Verified:
    """A run where it is; with ``audit`` lines of its cell, each signature must be among them."""
    found = fingerprint(run.path)
    verified = _of(run, found)
    verified.altered = _since_signed(verified, found)
    if audit is not None:
        verified.signatures = [(s, why or _unheard(s, audit)) for s, why in verified.signatures]
    return verified


def verify_bundle(bundle: Path) -> Verified:
    """A bundle, on whatever machine; it is unpacked beside the other temporary files for that."""
    with tempfile.TemporaryDirectory(prefix="cellward-") as place:
        folder, listed, damaged = unpack_bundle(bundle, Path(place))
        found = fingerprint(folder)
        altered = _without_sums(found).against(listed)
        run = load_run(Path(place), int(folder.name.rpartition("_")[2]))
        verified = _of(run, found)
        broken = tuple(f"{line.removesuffix(DAMAGED)} " for line in damaged)
        altered = damaged + [line for line in altered if not line.startswith(broken or ("\n",))]
        about = read_json(folder / BUNDLE_FILE)
        if isinstance(about, dict) and about.get("digest") != verified.digest and not altered:
            altered = [f"the record as a whole: {BUNDLE_FILE} has another digest"]
        verified.altered = altered or _since_signed(verified, found)
        return verified


def _without_sums(found: Fingerprint) -> Fingerprint:
    return Fingerprint({path: sum_ for path, sum_ in found.sums.items() if path != SUMS_FILE})


def _of(run: RunFolder, found: Fingerprint) -> Verified:
    verified = Verified(run.run_id, run.job, found.digest, len(found.record.sums))
    for signature in read_signatures(run.path):
        verified.signatures.append((signature, fault_of(signature, found)))
    _solve(run, verified)
    return verified


def _since_signed(verified: Verified, found: Fingerprint) -> list[str]:
    """The files that are not as the newest signature has them."""
    if not verified.signatures:
        return []
    newest = verified.signatures[-1][0]
    return found.record.against(newest.signed)


def _solve(run: RunFolder, verified: Verified) -> None:
    """Solve the raw data again; a job that keeps none, or data that no solver takes, is said."""
    try:
        recorded = run.read_result()
        if recorded is None:
            verified.unsolved = "the run has no result"
            return
        again = solve_again(run.job, run.path, run.info, recorded).as_json()
    except CellError as exc:
        verified.unsolved = str(exc)
        if exc.name != "NOT_FOUND":
            verified.differences = [{"where": "the answer", "recorded": "solved", "now": str(exc)}]
        return
    verified.differences = [d for d in differences(recorded, again) if not d["added"]]


def _unheard(signature: Signature, audit: Sequence[Mapping[str, Any]]) -> str:
    """Why the cell's audit does not bear a signature out; empty when it does."""
    for line in audit:
        what = str(line["what"])
        if line["accepted"] and what.startswith("sign ") and signature.digest in what:
            return ""
    return "the audit of this cell has no such signature"
