"""Opening the ledger's database: durable, brought into today's form, and a corrupt file set aside."""

import os
import sqlite3
from contextlib import closing
from pathlib import Path

from cell.errors import CellError, error
from cell.store.files import set_aside, sync_folder
from cell.store.migrations import MISSING, STEPS
from cell.version import software

SCHEMA_VERSION = 4
OPEN_S = 10.0  # so long a program that locks the file is waited for when it is opened ...
BUSY_S = 60.0  # ... and with it open: a copy or a query of somebody else must not cost a run its end
_SCHEMA = """
CREATE TABLE state (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE runs (
    run_id INTEGER PRIMARY KEY, job TEXT NOT NULL, folder TEXT NOT NULL, who TEXT NOT NULL,
    channel TEXT NOT NULL, started REAL NOT NULL, ended REAL, outcome TEXT, verdict TEXT,
    tool TEXT);
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


def open_database(path: Path) -> tuple[sqlite3.Connection, bool, Path | None]:
    """The connection, whether the database is new, and where a corrupt predecessor was set aside.

    One of an older form is changed step by step, in one transaction, after a copy was made beside it.
    ``STORE_NEWER`` for a database of a newer program: that one is intact and is left alone.
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
            raise error(
                "STORE_NEWER",
                f"{path}: a newer cellward has changed its form (schema {version}), and {software()} reads "
                f"{SCHEMA_VERSION} and older: install the newer one again, or put its copy of before "
                f"the change, {copy_before_change(path, SCHEMA_VERSION).name}, in its place",
            )
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        if version == 0 and connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0]:
            raise error("FILE_UNREADABLE", f"{path}: a database of another program; move it away")
        if version < SCHEMA_VERSION:
            if version:
                _copy(connection, copy_before_change(path, version))
            changes = "".join(STEPS[v] for v in range(version, SCHEMA_VERSION)) if version else _SCHEMA
            connection.executescript(f"BEGIN; {changes} PRAGMA user_version = {SCHEMA_VERSION}; COMMIT;")
        connection.execute(f"PRAGMA busy_timeout = {round(1000 * BUSY_S)}")
    except sqlite3.Error as exc:
        connection.close()
        raise disk_error(path, exc) from exc
    except BaseException:
        connection.close()
        raise
    return connection, version == 0, aside


def copy_before_change(path: Path, version: int) -> Path:
    """Where the database in the form of ``version`` stays when a newer program changes it."""
    return path.with_name(f"{path.name}.schema-{version}")


def _copy(connection: sqlite3.Connection, copy: Path) -> None:
    """All of the database as one file, safe on disk before anything is changed; an older copy stays."""
    if copy.exists():
        return
    draft = copy.with_name(copy.name + ".new")
    draft.unlink(missing_ok=True)
    connection.execute("VACUUM INTO ?", (str(draft),))
    with draft.open("rb") as file:
        os.fsync(file.fileno())
    draft.replace(copy)
    sync_folder(copy.parent)


def open_for_reading(path: Path) -> sqlite3.Connection:
    """A connection that changes nothing; ``LEDGER_DAMAGED``, ``ACCESS_DENIED``, ``FILE_UNREADABLE``.

    The file may be a running daemon's: whoever only looks must not set it aside.
    """
    if path.exists() and not os.access(path, os.R_OK, effective_ids=True):
        raise error("ACCESS_DENIED", f"{path}")
    try:
        return _open_to_read(path)
    except CellError as exc:
        if exc.name != "LEDGER_DAMAGED":
            raise
    return _open_to_read(path)  # a daemon that began to write meanwhile looks like damage, once


def _open_to_read(path: Path) -> sqlite3.Connection:
    try:
        connection = sqlite3.connect(_uri_to_read(path), uri=True, timeout=OPEN_S)
    except sqlite3.Error as exc:
        raise error("FILE_UNREADABLE", f"{path}: {exc}") from exc
    connection.row_factory = sqlite3.Row
    try:
        connection.execute("SELECT count(*) FROM calibrations").fetchone()
        version = connection.execute("PRAGMA user_version").fetchone()[0]
        if columns := MISSING.get(version):
            connection.execute(f"CREATE TEMP VIEW calibrations AS SELECT *, {columns} FROM main.calibrations")
    except sqlite3.Error as exc:
        connection.close()
        raise error("LEDGER_DAMAGED" if _damaged(exc) else "FILE_UNREADABLE", f"{path}: {exc}") from exc
    return connection


def _uri_to_read(path: Path) -> str:
    """A ledger that nobody has open has no log beside it; SQLite would make one, which who may only read
    cannot. It is read as it is then, without locks."""
    as_it_is = _may_only_read(path) and not path.with_name(path.name + "-wal").exists()
    return f"{path.absolute().as_uri()}?mode=ro{'&immutable=1' if as_it_is else ''}"


def _may_only_read(path: Path) -> bool:
    return not os.access(path.parent, os.W_OK, effective_ids=True)


def disk_error(path: Path, exc: sqlite3.Error) -> CellError:
    """SQLite's complaint as a coded error: about the file, the disk, or what this program asked for."""
    if _damaged(exc):
        if _may_only_read(path) and _sound(path):  # read without locks while a daemon began to write
            return error("NOT_NOW", f"{path} was changed while it was read: ask again")
        return error("LEDGER_DAMAGED", f"{path}: {exc}")
    if isinstance(exc, sqlite3.IntegrityError | sqlite3.ProgrammingError | sqlite3.InterfaceError):
        return error("INTERNAL", f"{path}: {exc}")
    full = getattr(exc, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL
    return error("DISK_FULL" if full else "DISK_FAILED", f"{path}: {exc}")


def _damaged(exc: sqlite3.Error) -> bool:
    """Whether the content of the file is what it complains of."""
    code = getattr(exc, "sqlite_errorcode", 0) & 0xFF  # the rest says more closely where
    return code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


def _sound(path: Path) -> bool:
    """Whether the file is in order when it is read anew; nothing is changed."""
    try:
        with closing(sqlite3.connect(_uri_to_read(path), uri=True, timeout=OPEN_S)) as connection:
            return bool(connection.execute("PRAGMA quick_check(1)").fetchone()[0] == "ok")
    except sqlite3.Error:
        return False


def _connect(path: Path) -> sqlite3.Connection:
    """Autocommit; transactions are begun explicitly. The ledger's lock serialises the threads."""
    try:
        connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=OPEN_S)
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
