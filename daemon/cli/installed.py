"""The drivers and jobs that a configuration can name: the shipped ones and those of installed packages."""

from daemon.cli.output import out, out_json
from procedures.words import table


def list_installed(drivers: bool, jobs: bool, as_json: bool) -> None:
    """Print what was asked for, each with its class and what keeps it from being used."""
    listed = {"drivers": _drivers()} if drivers else {}
    if jobs:
        listed["jobs"] = _jobs()
    if as_json:
        out_json(listed)
        return
    for what, rows in listed.items():
        columns = ("name", "class", "state")
        out(table((what[:-1], *columns[1:]), ([row[c] for c in columns] for row in rows)))


def _drivers() -> list[dict[str, str]]:
    from daemon.config.drivers import DRIVERS, driver_class, installed_drivers

    rows = [{"name": name, "class": place, "state": "shipped"} for name, place in sorted(DRIVERS.items())]
    for name, place in sorted(installed_drivers().items()):
        state = "installed"
        try:
            driver_class(name)
        except LookupError as exc:
            state = f"cannot be used: {exc.args[0]}"
        rows.append({"name": name, "class": place, "state": state})
    return rows


def _jobs() -> list[dict[str, str]]:
    from procedures.outside import installed_jobs
    from procedures.registry import SHIPPED, UNUSABLE

    rows = [
        {"name": name, "class": f"{job.__module__}:{job.__name__}", "state": "shipped"}
        for name, job in sorted(SHIPPED.items())
    ]
    for name, place in sorted(installed_jobs().items()):
        state = f"cannot be used: {UNUSABLE[name]}" if name in UNUSABLE else "installed"
        rows.append({"name": name, "class": place, "state": state})
    return rows
