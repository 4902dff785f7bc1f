"""Opening the ledger's database: durable, one schema version, and a corrupt file set aside."""

import sqlite3
from pathlib import Path

from cell.errors import CellError, error
from cell.store.files import set_aside

SCHEMA_VERSION = 3
_SCHEMA = """
CREATE TABLE state (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE runs (
    run_id INTEGER PRIMARY KEY, job TEXT NOT NULL, folder TEXT NOT NULL, who TEXT NOT NULL,
    channel TEXT NOT NULL, started REAL NOT NULL, ended REAL, outcome TEXT, verdict TEXT);
CREATE TABLE calibrations (
    id INTEGER PRIMARY KEY AUTOINCREMENT, name TEXT NOT NULL, state TEXT NOT NULL, version INTEGER,
    value TEXT NOT NULL, result TEXT NOT NULL, run_id INTEGER NOT NULL, config_value TEXT NOT NULL,
    proposed REAL NOT NULL, decided REAL, who TEXT, why TEXT, arm_model TEXT, folder TEXT,
    UNIQUE (name, version));
CREATE INDEX calibrations_by_name ON calibrations (name, state);
CREATE TABLE audit (
    id INTEGER PRIMARY KEY AUTOINCREMENT, at REAL NOT NULL, channel TEXT NOT NULL, who TEXT NOT NULL,
    what TEXT NOT NULL, accepted INTEGER NOT NULL, detail TEXT NOT NULL);
CREATE TABLE trends (name TEXT NOT NULL, t REAL NOT NULL, value REAL NOT NULL);
CREATE INDEX trends_by_name ON trends (name, t);
CREATE TABLE items (
    id INTEGER PRIMARY KEY AUTOINCREMENT, run_id INTEGER NOT NULL, item INTEGER NOT NULL, t REAL NOT NULL,
    outcome TEXT NOT NULL, detail TEXT NOT NULL);
CREATE INDEX items_by_run ON items (run_id);
"""
_FROM_2 = """
ALTER TABLE calibrations ADD COLUMN folder TEXT;
UPDATE calibrations SET folder = (SELECT folder FROM runs WHERE runs.run_id = calibrations.run_id);
"""
_CHANGES = {0: _SCHEMA, 1: "ALTER TABLE calibrations ADD COLUMN arm_model TEXT;" + _FROM_2, 2: _FROM_2}
_MISSING = {1: "NULL AS arm_model, NULL AS folder", 2: "NULL AS folder"}  # columns of older ledgers


def open_database(path: Path) -> tuple[sqlite3.Connection, bool, Path | None]:
    """The connection, whether the database is new, and where a corrupt predecessor was set aside.

    ``FILE_UNREADABLE`` for a database of a newer program: that one is intact and is left alone.
    """
    aside: Path | None = None
    if path.exists() and not _intact(path):
        aside = set_aside(path)
        for suffix in ("-wal", "-shm"):
            if (extra := path.with_name(path.name + suffix)).exists():
                set_aside(extra)
    connection = _connect(path)
    try:
        version = int(connection.execute("PRAGMA user_version").fetchone()[0])
        if version > SCHEMA_VERSION:
            raise error("FILE_UNREADABLE", f"{path}: schema {version}, this program knows {SCHEMA_VERSION}")
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        if version == 0 and connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0]:
            raise error("FILE_UNREADABLE", f"{path}: a database of another program; move it away")
        if version < SCHEMA_VERSION:
            connection.executescript(
                f"BEGIN; {_CHANGES[version]} PRAGMA user_version = {SCHEMA_VERSION}; COMMIT;"
            )
    except sqlite3.Error as exc:
        connection.close()
        raise disk_error(path, exc) from exc
    except BaseException:
        connection.close()
        raise
    return connection, version == 0, aside


def open_for_reading(path: Path) -> sqlite3.Connection:
    """A connection that changes nothing; ``FILE_UNREADABLE`` when there is no ledger that can be read.

    The file may be a running daemon's: whoever only looks must not set it aside.
    """
    connection = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=10.0)
    connection.row_factory = sqlite3.Row
    try:
        connection.execute("SELECT count(*) FROM calibrations").fetchone()
        version = connection.execute("PRAGMA user_version").fetchone()[0]
        if columns := _MISSING.get(version):
            connection.execute(f"CREATE TEMP VIEW calibrations AS SELECT *, {columns} FROM main.calibrations")
    except sqlite3.Error as exc:
        connection.close()
        raise error("FILE_UNREADABLE", f"{path}: {exc}") from exc
    return connection


def disk_error(path: Path, exc: sqlite3.Error) -> CellError:
    """SQLite's complaint as a coded error: about the disk, or about what this program asked for."""
    if isinstance(exc, sqlite3.IntegrityError | sqlite3.ProgrammingError | sqlite3.InterfaceError):
        return error("INTERNAL", f"{path}: {exc}")
    full = getattr(exc, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL
    return error("DISK_FULL" if full else "DISK_FAILED", f"{path}: {exc}")


def _connect(path: Path) -> sqlite3.Connection:
    """Autocommit; transactions are begun explicitly. The ledger's lock serialises the threads."""
    try:
        connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=10.0)
    except sqlite3.Error as exc:
        raise error("DISK_FAILED", f"{path}: {exc}") from exc
    connection.row_factory = sqlite3.Row
    return connection


def _intact(path: Path) -> bool:
    connection = _connect(path)
    try:
        return bool(connection.execute("PRAGMA quick_check(1)").fetchone()[0] == "ok")
    except sqlite3.OperationalError as exc:
        raise error("DISK_FAILED", f"{path}: {exc}") from exc
    except sqlite3.DatabaseError:
        return False
    finally:
        connection.close()
