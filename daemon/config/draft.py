"""A first ``cell.toml`` that holds what a cell has, cut out of the commented example."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from daemon.config.schema import init_text

_HEADER = re.compile(r"(# )?\[+(?P<name>[\w.-]+)\]+")
_KEY = re.compile(r"(# )?(?P<key>\w+) = ")
_ALWAYS = ("cell", "supervisor", "robot", "limits", "poses", "device.arm", "modbus")
_ROBOT_ALWAYS = ("arm", "model", "use_kinematics", "payload_kg", "centre_of_mass_m", "tool")


@dataclass(frozen=True)
class _Part:
    """What one thing in the cell brings: sections of the example, keys of ``[robot]``, poses."""

    sections: tuple[str, ...]
    robot: tuple[str, ...] = ()
    poses: tuple[str, ...] = ()


# Of the example's own cell, so with no values here: an arm would drive to poses that nobody has taught.
_MEASURED = {
    "payload_kg": "# payload_kg = KG   # weigh what is on the flange, tool included; 0.0 for nothing",
    "centre_of_mass_m": "# centre_of_mass_m = [X, Y, Z]   # of the payload, in the flange frame",
    "tool": '# tool = { name = "NAME", T_flange_tool = [X, Y, Z, RX, RY, RZ], radius_m = R }   # measure it',
}

_PARTS = {
    "camera": _Part(
        ("device.camera", "target.board", "job.cone-capture"), ("flange_camera", "T_flange_camera_nominal")
    ),
    "beams": _Part(("device.beams", "job.laser-reference"), ("beams",), ("aux_xs", "aux_ys")),
    "tracker": _Part(
        (
            "device.tracker",
            "device.tracker.reflectors",
            "job.tracker-sampling",
            "job.tracker-sampling.reflectors",
            "job.tracker-sampling.monuments",
        ),
        ("tracker",),
    ),
    "belt": _Part(
        ("device.belt", "device.belt_camera", "device.gripper", "job.belt-calibration", "job.belt-tracking"),
        ("belt", "belt_nominal", "gripper", "fixed_camera", "T_base_camera_nominal"),
        ("wait", "place"),
    ),
    "page": _Part(("http",)),
}


@dataclass(frozen=True)
class Cell:
    """What a cell has. Addresses are taken as given; ``check_config`` judges them."""

    name: str
    model: str
    arm: str
    camera: bool = False
    beams: str | None = None
    tracker: str | None = None
    belt: str | None = None
    plc: str | None = None
    page: bool = False

    def parts(self) -> list[_Part]:
        """What of the example it needs beyond the arm."""
        return [part for name, part in _PARTS.items() if getattr(self, name)]


def draft(cell: Cell) -> str:
    """The text of ``cell.toml``: the sections of the example that ``cell`` needs, with its addresses."""
    parts = cell.parts()
    sections = {*_ALWAYS, *(name for part in parts for name in part.sections)}
    wanted = {
        "robot": {*_ROBOT_ALWAYS, *(key for part in parts for key in part.robot)},
        "poses": {"home", *(key for part in parts for key in part.poses)},
    }
    kept = [
        list(_untaught(_only(lines, wanted[name]), name)) if name in wanted else lines
        for name, lines in _sections(init_text())
        if name in sections or not name
    ]
    text = "\n\n".join("\n".join(lines) for lines in kept) + "\n"
    for section, key, value in _values(cell):
        text = _set(text, section, key, value)
    text = re.sub(r'(?m)^(beams = "beams").*', r"\1", text)
    text = re.sub(r"(?m)^(expect_serial = )", r"# \1", text)  # 'cellward check --probe' names the true ones
    text = re.sub(r"(?m)^(payload_kg|centre_of_mass_m|tool) = .*$", lambda m: _MEASURED[m[1]], text)
    text = re.sub(r"(?m)^keep_out = .*$", "keep_out = []", text)
    first = text.partition("\n")[0]
    return text.replace(first, "# Configuration of one robot cell, drafted by 'cellward init'.", 1)


def _values(cell: Cell) -> Iterator[tuple[str, str, str]]:
    """Section, key and value in TOML of what was told."""
    yield "cell", "name", _quoted(cell.name)
    yield "robot", "model", _quoted(cell.model)
    yield "device.arm", "host", _quoted(cell.arm)
    for section, key, value in (
        ("device.beams", "url", cell.beams),
        ("device.tracker", "url", cell.tracker),
        ("device.belt", "bus", cell.belt),
    ):
        if value:
            yield section, key, _quoted(value)
    if cell.plc:
        yield "modbus", "bind", '"0.0.0.0:5020"'
        yield "modbus", "allow_write", "true"
        yield "modbus", "allow_clients", f"[{_quoted(cell.plc)}]"


def _sections(text: str) -> Iterator[tuple[str, list[str]]]:
    """Each section of the example by name, uncommented, with the prose before it; the head has no name.

    Keys that are commented out in a section that is not are optional, and stay so.
    """
    for block in _blocks(text):
        name, off = "", False
        lines: list[str] = []
        for line in block:
            if header := _HEADER.match(line):
                if name:
                    yield name, lines
                    lines = []
                name, off = header["name"], header[1] is not None
                lines.append(_in_force(line) if off else line)
            elif name and off and line.startswith("# "):
                lines.append(_in_force(line))
            else:
                lines.append(line)
        yield name, lines


def _blocks(text: str) -> Iterator[list[str]]:
    for block in text.rstrip().split("\n\n"):
        yield block.splitlines()


def _only(lines: list[str], keys: set[str]) -> list[str]:
    """The lines of these keys, in force; of others, whether they were or not, none."""
    kept = []
    for line in lines:
        match = _KEY.match(line)
        if match is None:
            kept.append(line)
        elif match["key"] in keys:
            kept.append(_in_force(line) if match[1] else line)
    return kept


def _untaught(lines: list[str], section: str) -> Iterator[str]:
    """Each pose as a comment that says what it is and how it is taught."""
    for line in lines:
        match = _KEY.match(line)
        if section != "poses" or match is None:
            yield line
            continue
        what = line.partition("   # ")[2]
        told = f" ({what.strip()})" if what else ""
        yield f"# {match['key']}{told}: bring the arm there, then 'cellward pose save {match['key']}'"


def _in_force(line: str) -> str:
    """A line that is commented out, as it is in force; the comment behind it stays where it was."""
    return line.removeprefix("# ").replace(" # ", "   # ", 1)


def _set(text: str, section: str, key: str, value: str) -> str:
    """``text`` with another value of a key, its comment behind it kept."""
    head = re.escape(f"[{section}]")
    pattern = rf'(?ms)(^{head}.*?^{key} = )("[^"]*"|\[[^\]]*\]|\S+)'
    changed, count = re.subn(pattern, lambda m: m[1] + value, text, count=1)
    if count != 1:
        raise LookupError(f"the example has no {key} in [{section}]")
    return changed


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
