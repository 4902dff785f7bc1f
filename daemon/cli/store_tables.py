"""Runs and results of a cell as two Parquet tables, so that a plant compares its cells with its own tools."""

import io
from collections.abc import Iterator, Mapping
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cell.errors import CellError, error
from cell.store.files import write_atomic
from cell.store.ledger import Ledger
from cell.store.run_list import listed_runs
from cell.store.runs import ALTERED, RunFolder, list_runs
from cell.store.summary import whole_result
from daemon.cli.export_source import uncertainty_of
from daemon.cli.options import CellPaths
from procedures.documents import read_result
from procedures.report.figures_csv import figure_rows

POSE = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
UNCERTAINTY = ("error_95_m", "error_95_rad", "predicted_error_95_m", "held_out_rms_m", "tracker_sigma_3d_m")
CELL = {"cell": "string", "twin": "bool", "config_sha256": "string", "software": "string", "run_id": "int64"}
RUNS = CELL | {
    "job": "string",
    "recipe": "string",
    "tool": "string",
    "started": "time",
    "ended": "time",
    "outcome": "string",
    "verdict": "string",
    "cause": "string",
    "started_by": "string",
    "kind": "string",
    "figure": "string",
    "figure_value": "double",
    "figure_95": "double",
    "figure_unit": "string",
    "figures": "figures",
}
RESULTS = CELL | {
    "result_id": "int64",
    "name": "string",
    "state": "string",
    "version": "int64",
    "proposed": "time",
    "decided": "time",
    "decided_by": "string",
    "why": "string",
    "kind": "string",
    "verdict": "string",
    **dict.fromkeys((*POSE, "time_offset_s", "m_per_count", *UNCERTAINTY), "double"),
}


def write_tables(paths: CellPaths, file: Path) -> list[tuple[Path, int]]:
    """``NAME.runs.parquet`` and ``NAME.results.parquet`` beside each other, with how many lines each has.

    A run that cannot be read is a line with what is known of it. ``ARGUMENT_INVALID`` without pyarrow.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise error(
            "ARGUMENT_INVALID", "--parquet needs pyarrow: install the extra cellward[parquet]"
        ) from None
    types = {
        "string": pa.string(),
        "bool": pa.bool_(),
        "int64": pa.int64(),
        "double": pa.float64(),
        "time": pa.timestamp("us", tz="UTC"),
        "figures": pa.map_(pa.string(), pa.float64()),
    }
    written = []
    for name, form, columns, lines in (
        ("runs", "cellward.runs-table/1", RUNS, _runs(paths)),
        ("results", "cellward.results-table/1", RESULTS, _results(paths)),
    ):
        schema = pa.schema(
            [(column, types[kind]) for column, kind in columns.items()],
            metadata={"schema": form},
        )
        table, content = pa.Table.from_pylist(list(lines), schema=schema), io.BytesIO()
        pq.write_table(table, content)
        path = file.with_name(f"{file.name.removesuffix('.parquet')}.{name}.parquet")
        write_atomic(path, content.getvalue())
        written.append((path, table.num_rows))
    return written


def _runs(paths: CellPaths) -> Iterator[dict[str, Any]]:
    folders = list_runs(paths.runs)
    listed = {run.run_id: run for run in listed_runs(paths.runs, None, max(len(folders), 1))}
    for folder in folders:
        run, document = listed[folder.run_id], _document(folder)
        started_by = folder.info.get("started_by")
        figure = run.figure
        yield _cell(paths, folder) | {
            "run_id": run.run_id,
            "job": run.job,
            "recipe": folder.info.get("recipe"),
            "tool": run.tool,
            "started": _moment(run.started),
            "ended": _moment(run.ended),
            "outcome": run.outcome,
            "verdict": run.verdict,
            "cause": run.cause,
            "started_by": started_by.get("who") if isinstance(started_by, Mapping) else None,
            "kind": document.get("kind"),
            "figure": figure and figure.name,
            "figure_value": figure and figure.value,
            "figure_95": figure and figure.uncertainty,
            "figure_unit": figure and figure.unit,
            "figures": {} if run.verdict == ALTERED else _figures(document),
        }


def _results(paths: CellPaths) -> Iterator[dict[str, Any]]:
    if not paths.ledger.exists():
        return
    folders = {folder.run_id: folder for folder in list_runs(paths.runs)}
    with closing(Ledger(paths.ledger, read_only=True)) as ledger:
        for entry in ledger.results(limit=-1)[::-1]:
            row = ledger.result(entry["id"])
            result, value = whole_result(row, paths.runs) or row["result"] or {}, row["value"]
            pose = value if isinstance(value, list) and len(value) == len(POSE) else [None] * len(POSE)
            uncertainty, _ = uncertainty_of(row["name"], result)
            yield _cell(paths, folders.get(row["run_id"])) | {
                "run_id": row["run_id"],
                "result_id": row["id"],
                **{key: row[key] for key in ("name", "state", "version", "why")},
                "proposed": _moment(row["proposed"]),
                "decided": _moment(row["decided"]),
                "decided_by": row["who"],
                **{key: result.get(key) for key in ("kind", "verdict")},
                **dict(zip(POSE, pose, strict=True)),
                **_numbers(value),
                **{key: uncertainty.get(key) for key in UNCERTAINTY},
            }


def _numbers(value: Any) -> dict[str, Any]:
    """Of a calibration that is no pose: a delay is a number alone, the scale of a belt stands in a table."""
    held = value if isinstance(value, Mapping) else {}
    delay = value if isinstance(value, int | float) else None
    return {"time_offset_s": delay, "m_per_count": held.get("m_per_count")}


def _cell(paths: CellPaths, folder: RunFolder | None) -> dict[str, Any]:
    """The cell as the run found it; of a run whose folder is gone, its name as it is configured now."""
    info = folder.info if folder is not None else {}
    config, versions = info.get("config"), info.get("versions")
    cell = config.get("cell") if isinstance(config, Mapping) else None
    known = cell if isinstance(cell, Mapping) else {}
    return {
        "cell": known.get("name") or paths.name,
        "twin": known.get("twin"),
        "config_sha256": info.get("config_digest"),
        "software": versions.get("cellward") if isinstance(versions, Mapping) else None,
    }


def _document(folder: RunFolder) -> dict[str, Any]:
    try:
        return folder.read_result() or {}
    except CellError:
        return {}


def _figures(document: Mapping[str, Any]) -> list[tuple[str, float]]:
    """Every single number of a result in SI by its key, as docs/results.md has them; none of lists."""
    try:
        rows = list(figure_rows(read_result(document))) if document else []
    except CellError:  # of a kind that is not installed here
        return []
    return [(key, float(v)) for key, v, _, _ in rows if isinstance(v, int | float) and "[" not in key]


def _moment(stamp: str | float | None) -> datetime | None:
    """Of ISO text, or of seconds since 1970."""
    if stamp is None:
        return None
    return datetime.fromisoformat(stamp) if isinstance(stamp, str) else datetime.fromtimestamp(stamp, UTC)
