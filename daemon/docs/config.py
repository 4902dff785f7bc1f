"""``docs/config.md``: every key of ``cell.toml``."""

import json
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from cell.formats.capture import TARGETS
from daemon.config.drivers import DRIVERS, driver_class
from daemon.config.models import FixedSections
from daemon.config.recipes import RecipeSection
from daemon.config.schema import SchemaWithDefaults
from daemon.config.tools import NamedToolSection
from daemon.docs.page import cell, page

HEAD = """
# Configuration

Source: the models in `daemon/config`, the drivers and the jobs. The file is `/etc/cellward/cell.toml`,
`$CELLWARD_CONFIG`, or what `--config` names. `cellward init` writes a commented one, `cellward check` finds
everything that is wrong with one. Unknown keys are errors. The program never writes this file.

A key without a default is **required** where its section or table is there; "none" is optional and absent.

A driver and a job may come from another package: `driver = "package.module:Class"` in `[device.NAME]`,
and `procedure = "package.module:Class"` in `[job.NAME]`; the further keys are those of its class. An
installed package that offers them as entry points (`cellward.drivers`, `cellward.procedures`) makes
short names of them; `cellward check --drivers --jobs` lists what is there; [an
example](examples/acme/README.md).

Every `[device.NAME]` may hold `calibrated = 2026-05-31`, the day of the instrument's last calibration:
reports show it beside the serial number.

Lengths are in metres, angles in radians. A pose is `[x, y, z, rx, ry, rz]`: translation and rotation vector.
"""

TOOLS = """
`[robot] tool` is a tool, too, where it is written: the one of a start that names none. `[job.NAME]` may have
`tool = "NAME"`, the tool of a start of this job that names none. Without either, a start has to name it;
[several tools](tools.md).
"""


def config_page(jobs: Mapping[str, Any]) -> str:
    """The text of ``docs/config.md``."""
    lines: list[str] = []
    for name, info in FixedSections.model_fields.items():
        if isinstance(info.annotation, type) and issubclass(info.annotation, BaseModel):
            lines += _section(f"[{info.alias or name}]", info.annotation)
    lines += ["## [poses]", "", "Named safe poses, always as six joints in radians.", ""]
    lines += [*_section("[tool.NAME]", NamedToolSection), *TOOLS.strip().splitlines(), ""]
    for name in sorted(DRIVERS):
        lines += _section(f'[device.NAME] with driver = "{name}"', driver_class(name).Config)
    for name, model in TARGETS.items():
        lines += _section(f'[target.NAME] with type = "{name}"', model)
    for name in sorted(jobs):
        lines += _section(f"[job.{name}]", jobs[name].Config)
    lines += [*_section("[recipe.NAME]", RecipeSection)]
    return page(HEAD, lines)


def _section(title: str, model: type[BaseModel]) -> list[str]:
    schema = model.model_json_schema(schema_generator=SchemaWithDefaults)
    first = (model.__doc__ or "").strip().split("\n\n")[0].replace("\n    ", " ")
    rows = ["| key | type | default | limits | meaning |", "|---|---|---|---|---|"]
    rows += _rows({**schema, "properties": _in_order(model, schema)}, schema.get("$defs", {}), "")
    return [f"## {title}", "", first, "", *rows, ""]


def _in_order(model: type[BaseModel], schema: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of ``schema``: those that are required, those of the model itself, those that it inherits."""
    fields, required = model.model_fields, schema.get("required", ())
    names = [name for cls in model.__mro__ for name in vars(cls).get("__annotations__", {}) if name in fields]
    keys = dict.fromkeys(fields[name].alias or name for name in names)
    return {key: schema["properties"][key] for key in sorted(keys, key=lambda key: key not in required)}


def _rows(
    schema: Mapping[str, Any],
    definitions: Mapping[str, Any],
    prefix: str,
    made: Mapping[str, Any] | None = None,
) -> list[str]:
    """One row a key; ``made`` has the defaults of this table where it is used, which go before its own."""
    rows: list[str] = []
    for key, entry in schema.get("properties", {}).items():
        meaning = cell(entry.get("description", ""))
        inner = _definition(entry, definitions)
        required = key in schema.get("required", ()) and key not in (made or {})
        standing = (made or {}).get(key, entry.get("default"))
        default = "**required**" if required else cell(toml_text(standing))
        if inner is not None and "properties" in inner:
            word = default if required else "none" if standing is None else "as below"
            rows.append(f"| `{prefix}{key}` | table | {word} | | {meaning} |")
            rows += _rows(inner, definitions, f"{prefix}{key}.", standing)
            continue
        among = entry.get("anyOf") or entry.get("oneOf") or [entry]
        options = [o for o in among if o.get("type") != "null"]
        kinds = " or ".join(_kind(option, definitions) for option in options)
        limits = ", ".join(filter(None, (limits_text(option) for option in options)))
        rows.append(f"| `{prefix}{key}` | {cell(kinds)} | {default} | {cell(limits)} | {meaning} |")
    return rows


def _definition(entry: Mapping[str, Any], definitions: Mapping[str, Any]) -> Mapping[str, Any] | None:
    options = [entry, *entry.get("anyOf", []), *entry.get("allOf", [])]
    refs = [option["$ref"] for option in options if "$ref" in option]
    found: Mapping[str, Any] | None = definitions[refs[0].rpartition("/")[2]] if refs else None
    return found


def _kind(entry: Mapping[str, Any], definitions: Mapping[str, Any]) -> str:
    """What a value is, in words."""
    if "$ref" in entry:
        inner = definitions[entry["$ref"].rpartition("/")[2]]
        return f"table of {', '.join(inner['properties'])}" if "properties" in inner else _kind(inner, {})
    if "enum" in entry or "const" in entry:
        return " or ".join(f'"{value}"' for value in entry.get("enum", [entry.get("const")]))
    kind = str(entry.get("type", "any"))
    if kind == "array":
        size = entry.get("minItems")
        exact = f"{size} " if size and size == entry.get("maxItems") else ""
        return f"list of {exact}{_kind(entry.get('items', {}), definitions)}"
    return {"integer": "whole number", "boolean": "true or false"}.get(kind, kind)


def limits_text(entry: Mapping[str, Any]) -> str:
    """The bounds of a value in words, from its JSON schema."""
    words = {
        "minimum": "at least", "exclusiveMinimum": "above", "maximum": "at most", "exclusiveMaximum": "below",
        "multipleOf": "multiple of",
    }  # fmt: skip
    return ", ".join(f"{word} {entry[key]:g}" for key, word in words.items() if key in entry)


def toml_text(value: Any) -> str:
    """A value as it is written in ``cell.toml``."""
    if value is None:
        return "none"
    return (
        "`" + (str(value).lower() if isinstance(value, bool) else json.dumps(value, ensure_ascii=False)) + "`"
    )
