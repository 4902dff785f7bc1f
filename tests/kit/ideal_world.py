"""A shipped scenario as text without what an ideal world leaves out, to be changed line by line."""

import tomllib
from importlib.resources import files

from fakes.world.scenario import left_out


def shipped_text(name: str) -> str:
    """The scenario as it is shipped."""
    return files("fakes").joinpath(f"scenarios/{name}.toml").read_text("utf-8")


def ideal_text(name: str) -> str:
    """The same cell in an ideal world, which is what ``NAME:ideal`` loads.

    Not for a scenario that is like another: what is to be left out stands in that one's text, too.
    """
    text = shipped_text(name)
    if "\nlike = " in text:
        raise ValueError(f"{name} is like another scenario, so its text alone has no ideal world")
    unkind = left_out(tomllib.loads(text)["world"])
    kept, table, within = list[str](), "", True
    for line in text.splitlines():
        if line.startswith("["):
            _, table, key, *_ = [*line.strip("[] ").split("."), "", ""]
            within = key not in unkind.get(table, ()) and table not in unkind[""]
        if within and (line.startswith("[") or line.split("=")[0].strip() not in unkind.get(table, ())):
            kept.append(line)
    return "\n".join(kept) + "\n"


def prompt_station() -> str:
    """The tracker's cell in an ideal world, with an instrument that turns and searches sooner."""
    return ideal_text("tracker").replace(
        "[world.tracker]\n", "[world.tracker]\nsearch_s = 0.05\nturn_rad_s = 20.0\n"
    )
