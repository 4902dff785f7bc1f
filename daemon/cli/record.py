"""The record of a run for others: signatures, one file with everything, and whether it is what it was."""

from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import error
from daemon.cli.damaged import reading
from daemon.cli.failures import FAILED
from daemon.cli.history import RunArgument, decisions, load, renew_report
from daemon.cli.jobs import connect
from daemon.cli.options import CellPaths, ConfigOption, JsonOption, cell_paths
from daemon.cli.output import out, out_json, say
from procedures.words import local_time, table

SIGN_TIMEOUT_S = 300.0  # the daemon reads every file of the run
MOST_AUDITED = 100_000


def sign(
    run: RunArgument,
    name: Annotated[str, typer.Option("--as", help="Who signs.", show_default=False)],
    role: Annotated[
        str, typer.Option("--role", help="As what: measured, checked, approved, ...", show_default=False)
    ],
    remark: Annotated[str, typer.Option("--remark", help="One line that stands beside the signature.")] = "",
    config: ConfigOption = None,
) -> None:
    """Sign the record of a run: name, role, time and the digest of its files go into it and into the audit.

    The signature says who looked at this record and stands for it; it accepts nothing.
    """
    from cell.store.fingerprint import fingerprint

    folder = load(config, run)
    with reading(folder.path):
        digest = fingerprint(folder.path).digest
    with connect(config) as daemon:
        # The digest stands first: the audit, which bears it out, shortens a long remark.
        said = {"run_id": run, "digest": digest, "name": name, "role": role, "remark": remark}
        made = daemon.call("sign", timeout=SIGN_TIMEOUT_S, **said)
    say(f"Run {run} is signed by {made['name']} ({made['role']}), with the account {made['user']}.")
    say(f"Digest of its {len(made['sums'])} files: {digest}")
    say(f"Its report shows the signature: cellward report {run}.")


def bundle(
    run: RunArgument,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="The file; RUNFOLDER.zip here unless given.", show_default=False),
    ] = None,
    config: ConfigOption = None,
) -> None:
    """One file with everything of a run: raw data, result, report, configuration, versions, check sums.

    'cellward verify FILE' checks it on any machine, 'sha256sum -c SHA256SUMS' what is unpacked of it.
    """
    from cell.store.bundle import write_bundle

    folder = load(config, run)
    if folder.read_end() is None:
        raise error("NOT_NOW", f"run {run} ({folder.job}) has not ended; it can be bundled after its end")
    target = output or Path(f"{folder.path.name}.zip")
    if not target.absolute().parent.is_dir():
        raise error("ARGUMENT_INVALID", f"{target}: the folder {target.absolute().parent} does not exist")
    with reading(folder.path):
        renew_report(folder, cell_paths(config))
        made = write_bundle(folder.path, target, _about(folder, cell_paths(config)))
    out(str(target))
    say(f"{len(made.sums)} files; the digest of the record is {made.digest}")


def _about(folder: Any, paths: CellPaths) -> dict[str, Any]:
    """What the bundle says of the run beside its files: which software packed it, and what was decided."""
    from datetime import UTC, datetime

    from daemon.run_origin import versions

    return {
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "made_by": dict(versions()),
        "run_id": folder.run_id,
        "job": folder.job,
        "decisions": decisions(paths, folder.run_id),
    }


def verify(
    what: Annotated[
        str, typer.Argument(metavar="FILE|RUN", help="A bundle, or the number of a run.", show_default=False)
    ],
    digest: Annotated[
        str, typer.Option("--digest", help="The digest that a signed paper shows, or how it begins.")
    ] = "",
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check a bundle or a run: files altered, signatures, and whether the raw data give the same answer.

    Exit code 1 when anything is not as it was. A bundle needs no cell.
    """
    from daemon.cli.verifying import verify_bundle, verify_run

    if what.isdecimal() and not Path(what).exists():
        folder = load(config, int(what))
        with reading(folder.path):
            found = verify_run(folder, _audit(cell_paths(config)))
    else:
        found = verify_bundle(Path(what))
    if digest and (len(digest) < 8 or not found.digest.startswith(digest.lower())):
        found.altered.append(f"the record as a whole: its digest is {found.digest}, not {digest}")
    if as_json:
        out_json(found.as_dict())
    else:
        _tell(found)
    if not found.good:
        raise typer.Exit(FAILED)


def _tell(found: Any) -> None:
    out(f"run {found.run_id} ({found.job}): {found.files} files, digest {found.digest}")
    for line in found.altered:
        out(f"  NOT AS IT WAS: {line}")
    for signature, why in found.signatures:
        kept = f"WRONG: {why}" if why else "for these very files"
        out(f"  signed {local_time(signature.at)} by {signature.name} ({signature.role}): {kept}")
    if not found.signatures:
        out("  nobody has signed it")
    if found.differences:
        out("  NOT THE SAME ANSWER when the data are solved again:")
        rows = ([d["where"], d["recorded"], d["now"]] for d in found.differences)
        out(table(("  where", "recorded", "now"), (["  " + r[0], *r[1:]] for r in rows)))
    elif found.unsolved:
        out(f"  not solved again: {found.unsolved}")
    else:
        out("  solved again from the raw data: the same answer")
    out("good" if found.good else "NOT GOOD")


def _audit(paths: CellPaths) -> list[dict[str, Any]] | None:
    if not paths.ledger.exists():
        return None
    from cell.store.ledger import Ledger

    ledger = Ledger(paths.ledger, read_only=True)
    try:
        return ledger.audit_lines(MOST_AUDITED)
    finally:
        ledger.close()
