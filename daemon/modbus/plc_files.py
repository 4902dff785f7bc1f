"""What a PLC's project takes in: the register table as CSV, and as PLCopen XML with the function blocks.

PLCopen XML is version 2.01 of the exchange format of PLCopen's committee TC6, which the programming systems
of most makers import. The function blocks are those of ``plc/cellward.st``; the rest is the register table.
"""

import csv
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from xml.etree import ElementTree as xml

from daemon.modbus.table import Register, RegisterTable

NAMESPACE = "http://www.plcopen.org/xml/tc6_0201"
XHTML = "http://www.w3.org/1999/xhtml"
COLUMNS = ("block", "address", "bit", "value", "name", "type", "unit", "meaning")
TYPES = {"uint16": "UINT", "uint32": "UDINT", "float32": "REAL"}
SECTIONS = {"VAR_INPUT": "inputVars", "VAR_OUTPUT": "outputVars", "VAR": "localVars"}
PREFIXES = {
    "command": "COMMAND",
    "job": "JOB",
    "status": "STATUS",
    "warning_bits": "WARNING",
    "control": "CONTROL",
}
_BLOCK = re.compile(
    r"(?:\(\*((?:[^*]|\*(?!\)))*)\*\)\s*)?FUNCTION_BLOCK (\w+)\n(.*?)END_FUNCTION_BLOCK", re.S
)
_SECTION = re.compile(r"^(VAR\w*)\n(.*?)^END_VAR\n", re.S | re.M)
_VARIABLE = re.compile(r"^ +(\w+) : ([^:;]+?)(?: := ([^;]+))?;(?: *\(\* (.*?) \*\))?$", re.M)
_ARRAY = re.compile(r"ARRAY\[(\d+)\.\.(\d+)\] OF (\w+)")


def structured_text() -> str:
    """The function blocks as Structured Text."""
    return files("daemon.modbus").joinpath("plc/cellward.st").read_text("utf-8")


def robot_script() -> str:
    """The functions of a robot program that asks for a check of its tool, as URScript."""
    return files("daemon.modbus").joinpath("plc/cellward.script").read_text("utf-8")


def register_csv(table: RegisterTable) -> str:
    """A row a register, and one for each of its bits and values; RFC 4180."""
    text = io.StringIO()
    rows = csv.writer(text)
    rows.writerow(COLUMNS)
    for block, registers in (("holding", table.command), ("input", table.readable)):
        for r in registers:
            rows.writerow((block, r.address, "", "", r.name, r.type, r.unit, r.meaning))
            rows.writerows(
                (block, r.address, bit, "", r.name, "", "", text) for bit, text in enumerate(r.bits)
            )
            rows.writerows(
                (block, r.address, "", value, r.name, "", "", text) for value, text in r.values.items()
            )
    return text.getvalue()


def plcopen_xml(table: RegisterTable, created: str) -> str:
    """Function blocks and named constants as one importable project; ``created`` is a time as ISO 8601."""
    project = xml.Element("project", xmlns=NAMESPACE)
    xml.SubElement(
        project,
        "fileHeader",
        companyName="Cellward",
        productName="Cellward",
        productVersion="1",
        creationDateTime=created,
    )
    content = xml.SubElement(project, "contentHeader", name="Cellward")
    coordinates = xml.SubElement(content, "coordinateInfo")
    for diagram in ("fbd", "ld", "sfc"):
        xml.SubElement(xml.SubElement(coordinates, diagram), "scaling", x="1", y="1")
    types = xml.SubElement(project, "types")
    xml.SubElement(types, "dataTypes")
    pous = xml.SubElement(types, "pous")
    for block in function_blocks():
        _add_block(pous, block)
    instances = xml.SubElement(xml.SubElement(project, "instances"), "configurations")
    configuration = xml.SubElement(instances, "configuration", name="Cellward")
    constants = xml.SubElement(configuration, "globalVars", name="Cellward", constant="true")
    for name, value, meaning in named_constants(table):
        _add_variable(constants, name, "WORD" if value.startswith("16#") else "UINT", value, meaning)
    xml.indent(project, " ")
    return '<?xml version="1.0" encoding="utf-8"?>\n' + xml.tostring(project, encoding="unicode") + "\n"


@dataclass(frozen=True)
class FunctionBlock:
    """A function block of the text: its variables by section, and its body."""

    name: str
    meaning: str
    sections: dict[str, list[tuple[str, str, str | None, str]]]  # name, type, initial value, meaning
    body: str


def function_blocks() -> list[FunctionBlock]:
    """The blocks of :func:`structured_text`, in its order."""
    found = []
    for match in _BLOCK.finditer(structured_text()):
        meaning, name, text = match.groups()
        sections = {
            SECTIONS[section]: [
                (n, kind, initial or None, said) for n, kind, initial, said in _VARIABLE.findall(variables)
            ]
            for section, variables in _SECTION.findall(text)
        }
        said = " ".join((meaning or "").split())
        found.append(FunctionBlock(name, said, sections, _SECTION.sub("", text).strip("\n")))
    return found


def named_constants(table: RegisterTable) -> Iterator[tuple[str, str, str]]:
    """Name, value and meaning of each command, job and bit: ``JOB_LASER_CHECK``, ``STATUS_READY``."""
    for r in (*table.command, *table.status):
        if r.name in PREFIXES:
            yield from _constants_of(r)


def _constants_of(register: Register) -> Iterator[tuple[str, str, str]]:
    prefix = PREFIXES[register.name]
    for value, text in register.values.items():
        yield f"{prefix}_{_word(text)}", str(value), text
    for bit, text in enumerate(register.bits):
        if not text.startswith("reserved"):
            name = f"{prefix}_BIT_{bit}" if prefix == "WARNING" else f"{prefix}_{_word(text)}"
            yield name, f"16#{1 << bit:04X}", text


def _word(text: str) -> str:
    """``accept result (run id ...)`` as a name: ``ACCEPT_RESULT``."""
    return re.sub(r"\W+", "_", re.split(r"[:(,]", text)[0].strip()).upper()


def _add_block(pous: xml.Element, block: FunctionBlock) -> None:
    pou = xml.SubElement(pous, "pou", name=block.name, pouType="functionBlock")
    interface = xml.SubElement(pou, "interface")
    for section, variables in block.sections.items():
        group = xml.SubElement(interface, section)
        for variable in variables:
            _add_variable(group, *variable)
    body = xml.SubElement(xml.SubElement(pou, "body"), "ST")
    xml.SubElement(body, "xhtml", xmlns=XHTML).text = block.body
    _document(pou, block.meaning)


def _add_variable(parent: xml.Element, name: str, kind: str, initial: str | None, meaning: str) -> None:
    variable = xml.SubElement(parent, "variable", name=name)
    _add_type(xml.SubElement(variable, "type"), kind)
    if initial is not None:
        xml.SubElement(xml.SubElement(variable, "initialValue"), "simpleValue", value=initial)
    if meaning:
        _document(variable, meaning)


def _add_type(parent: xml.Element, kind: str) -> None:
    if array := _ARRAY.fullmatch(kind):
        lower, upper, of = array.groups()
        element = xml.SubElement(parent, "array")
        xml.SubElement(element, "dimension", lower=lower, upper=upper)
        _add_type(xml.SubElement(element, "baseType"), of)
    elif kind.startswith("FB_") or kind == "TON":
        xml.SubElement(parent, "derived", name=kind)
    else:
        xml.SubElement(parent, kind)


def _document(parent: xml.Element, text: str) -> None:
    xml.SubElement(xml.SubElement(parent, "documentation"), "xhtml", xmlns=XHTML).text = text
