"""The configuration described for machines (JSON schema) and for people (a commented file)."""

from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, models_json_schema

from cell.formats.capture import TARGETS
from daemon.config.drivers import DRIVERS, driver_class
from daemon.config.load import device_model
from daemon.config.models import FixedSections
from daemon.config.recipes import NAME as RECIPE_NAME
from daemon.config.recipes import RecipeSection

TOOL_OF_A_JOB = {
    "type": "string",
    "title": "Tool",
    "description": "the tool of a start of this job that names none",
}


class SchemaWithDefaults(GenerateJsonSchema):
    """The schema with every default, also of keys whose default is made anew for each section."""

    def get_default_value(self, schema: Any) -> Any:
        factory = schema.get("default_factory")
        return super().get_default_value(schema) if factory is None else factory()


def init_text() -> str:
    """A commented configuration for a UR10e with an OAK camera; valid as it stands."""
    return files("daemon.config").joinpath("cell.toml").read_text("utf-8")


def json_schema(jobs: Mapping[str, Any], drivers: Mapping[str, str] = DRIVERS) -> dict[str, Any]:
    """JSON schema (2020-12) of ``cell.toml`` with every driver, job and target type there is."""
    devices = {name: device_model(driver_class(name, drivers).Config) for name in sorted(drivers)}
    configs = {name: jobs[name].Config for name in sorted(jobs)}
    models: list[type[BaseModel]] = [FixedSections, *devices.values(), *configs.values(), *TARGETS.values()]
    refs, document = models_json_schema(
        [(model, "validation") for model in models],
        ref_template="#/$defs/{model}",
        schema_generator=SchemaWithDefaults,
    )

    def ref(model: type[BaseModel]) -> dict[str, Any]:
        return dict(refs[model, "validation"])

    definitions = document["$defs"]
    root = definitions.pop(ref(FixedSections)["$ref"].rpartition("/")[2])
    for name, model in devices.items():
        definition = definitions[ref(model)["$ref"].rpartition("/")[2]]
        definition["properties"]["driver"]["const"] = name
    named = {"properties": {"driver": {"type": "string", "pattern": ":"}}, "required": ["driver"]}
    choices = [*(ref(m) for m in devices.values()), {"type": "object", **named}]
    root["properties"]["device"]["additionalProperties"] = {"anyOf": choices}
    root["properties"]["target"]["additionalProperties"] = {"anyOf": [ref(m) for m in TARGETS.values()]}
    for model in configs.values():
        definition = definitions[ref(model)["$ref"].rpartition("/")[2]]
        definition.setdefault("properties", {})["tool"] = TOOL_OF_A_JOB
    root["properties"]["job"] = {
        "type": "object",
        "title": "Job",
        "properties": {name: ref(model) for name, model in configs.items()},
        "additionalProperties": {  # of another package
            "type": "object",
            "properties": {"procedure": {"type": "string", "pattern": ":"}},
            "required": ["procedure"],
        },
    }
    recipe = RecipeSection.model_json_schema()
    recipe["properties"]["tool"] = TOOL_OF_A_JOB
    root["properties"]["recipe"]["patternProperties"] = {
        RECIPE_NAME: {**recipe, "additionalProperties": True}
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **root,
        "title": "cell.toml",
        "$defs": definitions,
    }
