"""JSON Schema of a spec file, for completion and hints in editors, with the settings of every installed plugin."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel
from pydantic.errors import PydanticUserError

from ..errors import PluginError
from ..registry import load, names, singular
from .merge import PARTS, RANDOMIZATION, SWEEP, TRANSFER
from .model import NAME_PATTERN, PARAMETER_PATTERN, DemonstrationSettings, Spec, TestingSettings, TrainingSettings
from .sweep import Sweep
from .transfer import Transfer

SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"
Schema = dict[str, Any]


def spec_schema() -> tuple[Schema, list[PluginError]]:
    """The schema, and the errors of plugins that cannot be imported, which it does not contain.

    Keys that an extended file may hold are not required; `karolos check` validates the merged spec.
    """
    definitions: Schema = {}
    broken: list[PluginError] = []
    properties: Schema = {
        "extends": {
            "description": "spec files to merge this one into, relative to it; later ones have priority",
            "anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}],
        },
        "name": {"type": "string", "pattern": NAME_PATTERN},
        "seeds": {"type": "array", "items": {"type": "integer", "minimum": 0}, "minItems": 1, "uniqueItems": True},
        **{key: _part(kind, definitions, broken) for key, kind in PARTS.items()},
        RANDOMIZATION: {
            "type": "object",
            "patternProperties": {PARAMETER_PATTERN: _or_null(_distribution(definitions, broken))},
            "additionalProperties": False,
        },
        "demonstrations": _settings(DemonstrationSettings, "demonstrations", definitions),
        "training": _settings(TrainingSettings, "training", definitions),
        "testing": _settings(TestingSettings, "testing", definitions),
        SWEEP: _settings(Sweep, SWEEP, definitions),
        TRANSFER: _settings(Transfer, TRANSFER, definitions),
    }
    for key, field in Spec.model_fields.items():
        properties[key] = {"description": field.description, **properties[key]}
    schema: Schema = {
        "$schema": SCHEMA_DIALECT,
        "title": "karolos spec",
        "type": "object",
        "properties": {key: _or_null(entry) for key, entry in properties.items()},
        "additionalProperties": False,
        "if": {"not": {"required": ["extends"]}},
        "then": {
            "required": ["agent"],
            "anyOf": [{"required": ["robot", "task"]}, {"required": ["environment"]}],
        },
        "$defs": definitions,
    }
    return schema, broken


def _part(kind: str, definitions: Schema, broken: list[PluginError]) -> Schema:
    """A name, or a mapping with the settings of the named plugin."""
    installed, cases = [], []
    for name in names(kind):
        try:
            settings = load(kind, name).Settings
            entry = _settings(settings, f"{kind}.{name}", definitions)
        except PluginError as error:
            broken.append(error)
            continue
        except PydanticUserError as error:  # a type without JSON Schema
            text = str(error).splitlines()[0]
            broken.append(PluginError(text, where=f"{singular(kind)} {name!r}", hint="settings must be plain data"))
            continue
        entry["properties"] = {"name": {"const": name}, **entry.get("properties", {})}
        definitions[f"{kind}.{name}"] = entry
        installed.append(name)
        named = {"properties": {"name": {"const": name}}, "required": ["name"]}
        cases.append({"if": {"type": "object", **named}, "then": {"$ref": f"#/$defs/{kind}.{name}"}})
    mapping: Schema = {"type": "object", "properties": {"name": {"enum": installed}}}
    if cases:
        mapping["allOf"] = cases
    return {"anyOf": [{"enum": installed}, mapping]}


def _distribution(definitions: Schema, broken: list[PluginError]) -> Schema:
    """A number, or a part."""
    part = _part("distributions", definitions, broken)
    return {"anyOf": [{"type": "number"}, *part["anyOf"]]}


def _settings(model: type[BaseModel], name: str, definitions: Schema) -> Schema:
    """The schema of a settings model; adds nested models to `definitions`."""
    schema = model.model_json_schema(ref_template=f"#/$defs/{name}.{{model}}")
    for nested, entry in schema.pop("$defs", {}).items():
        definitions[f"{name}.{nested}"] = entry
    schema.pop("required", None)  # an extended file may hold it
    schema.pop("title", None)
    return schema


def _or_null(schema: Schema) -> Schema:
    """The schema with null, which removes a key, also one of an extended file."""
    description = schema.pop("description", None)
    either = {"anyOf": [*schema.get("anyOf", [schema]), {"type": "null"}]}
    return {"description": description, **either} if description else either
