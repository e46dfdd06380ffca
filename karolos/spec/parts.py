"""The pydantic field type of a part, which the plugin of its `name` validates.

A pydantic union over plugins would import all of them and reject plugins of other packages. Errors have paths in the
spec, e.g. agent.learning_rate.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BaseModel, GetCoreSchemaHandler, ValidationError
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from ..errors import UsageError
from ..registry import load, singular
from .recipe import Part


@dataclass(frozen=True)
class OfKind:
    """Marks a field that holds a part of this kind."""

    kind: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.validate)

    def validate(self, value: object) -> Part:
        """Convert a mapping with `name` and settings. Raises ValidationError at paths below this field."""
        if isinstance(value, Part):
            return value
        what = _with_article(singular(self.kind))
        if not isinstance(value, dict):
            raise PydanticCustomError("part_type", f"should be the name of {what}, or a mapping with `name`")
        if "name" not in value:
            raise _at_name("missing_name", f"should name {what}", value)
        name = value["name"]
        if not isinstance(name, str):
            raise _at_name("name_type", f"should be the name of {what}", name)
        try:
            plugin = load(self.kind, name)
        except UsageError as error:
            raise _at_name("unknown_name", error.what, name, error.hint) from None
        settings = {key: entry for key, entry in value.items() if key != "name"}
        return Part(self.kind, name, validate_strictly(plugin.Settings, settings))


def _with_article(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def _at_name(kind: str, message: str, value: object, hint: str | None = None) -> ValidationError:
    error = PydanticCustomError(kind, "{message}", {"message": message, "hint": hint})
    return ValidationError.from_exception_data("Part", [InitErrorDetails(type=error, loc=("name",), input=value)])


def validate_strictly(model: type[BaseModel], value: object) -> Any:
    """Convert plain data to a model without coercion: "5" is not a number, true is not 1; 1e6 is an integer.

    JSON mode lets strict models accept lists for tuples and strings for enumerations.
    """
    return model.model_validate_json(json.dumps(_integers(value)), strict=True)


def _integers(value: object) -> object:
    """Convert whole floats to integers, which float fields accept too."""
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, dict):
        return {key: _integers(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_integers(entry) for entry in value]
    return value


RobotPart = Annotated[Part, OfKind("robots")]
TaskPart = Annotated[Part, OfKind("tasks")]
EnvironmentPart = Annotated[Part, OfKind("environments")]
AgentPart = Annotated[Part, OfKind("agents")]
BufferPart = Annotated[Part, OfKind("buffers")]
OrchestratorPart = Annotated[Part, OfKind("orchestrators")]
DistributionPart = Annotated[Part, OfKind("distributions")]
