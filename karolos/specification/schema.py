"""JSON Schema of a spec file, for completion and hints in editors, with the settings of every installed plugin."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel
from pydantic.errors import PydanticUserError

from ..errors import PluginError
from ..registry import KINDS, load, names, singular
from .model import Spec

SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"
Schema = dict[str, Any]


def spec_schema() -> tuple[Schema, list[PluginError]]:
    """The schema, and the errors of plugins that cannot be imported, which it does not contain.

    No key is required that an extended file may hold; `karolos check` validates the merged spec.
    """
    definitions: Schema = {}
    broken: list[PluginError] = []
    parts = {kind: _part(kind, definitions, broken) for kind in KINDS}
    parts["distributions"]["anyOf"].append({"type": "number"})
    properties = _with_parts(_settings(Spec, "spec", definitions)["properties"], parts)
    paths = {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]}
    description = "spec files to merge this one into, relative to it; later ones have priority"
    properties = {"extends": {"description": description, **paths}, **properties}
    (parameter, distribution), *_ = properties["randomization"]["patternProperties"].items()
    properties["randomization"]["patternProperties"] = {parameter: _or_null(distribution)}
    properties["randomization"]["additionalProperties"] = False
    return {
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
    }, broken


def _with_parts(schema: Any, parts: dict[str, Schema]) -> Any:
    """The schema with the marks of `OfKind` replaced by the plugins of that kind."""
    if isinstance(schema, list):
        return [_with_parts(entry, parts) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    part = parts.get(schema.get("kind", ""), {})
    return {key: _with_parts(entry, parts) for key, entry in schema.items() if not part or key != "kind"} | part


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


def _settings(model: type[BaseModel], name: str, definitions: Schema) -> Schema:
    """The schema of a settings model; adds nested models to `definitions`."""
    schema = model.model_json_schema(ref_template=f"#/$defs/{name}.{{model}}")
    nested = {f"{name}.{key}": entry for key, entry in schema.pop("$defs", {}).items()}
    definitions.update(nested)
    for entry in (schema, *nested.values()):
        entry.pop("required", None)  # an extended file may hold it
        entry.pop("title", None)
    return schema


def _or_null(schema: Schema) -> Schema:
    """The schema with null, which removes a key of the file or of an extended file."""
    description = schema.pop("description", None)
    either = {"anyOf": [*schema.get("anyOf", [schema]), {"type": "null"}]}
    return {"description": description, **either} if description else either
