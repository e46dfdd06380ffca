"""The parts of a spec, the recipe of an environment, and the pydantic field type of a part."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, GetCoreSchemaHandler, SecretStr, ValidationError
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from ..errors import UsageError, recorded
from ..registry import load, singular


@dataclass(frozen=True)
class Part:
    """One part of a spec: a plugin and its validated settings.

    Unpickling imports the plugin's module, for its Settings class, and no other plugin.
    """

    kind: str
    """A kind of `karolos.registry.KINDS`, e.g. "robots"."""
    name: str
    settings: Any
    """An instance of the plugin's `Settings`."""

    def dump(self, *, changed: bool = False, given: bool = False) -> dict[str, Any]:
        """Name and all settings as in a spec, or only those that are no defaults, or that were given; JSON-able."""
        settings: BaseModel = self.settings
        return {"name": self.name, **settings.model_dump(mode="json", exclude_defaults=changed, exclude_unset=given)}

    def identity(self) -> dict[str, Any]:
        """Name and the settings that results depend on: `Settings.identity()` if defined, otherwise all."""
        identity = getattr(self.settings, "identity", None)
        return {"name": self.name, **identity()} if callable(identity) else self.dump()


@dataclass(frozen=True)
class Recipe:
    """How to build one environment."""

    environment: Part
    robot: Part | None = None
    task: Part | None = None
    randomization: tuple[tuple[str, Part], ...] = ()
    """Parameters to draw at each reset ("task.gravity") with their distributions, sorted by name."""


@dataclass(frozen=True)
class OfKind:
    """Marks a field that holds a part of this kind, which the plugin of its `name` validates.

    A pydantic union over plugins would import all of them and reject plugins of other packages. Errors have paths in
    the spec, e.g. agent.learning_rate.
    """

    kind: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        dump = core_schema.plain_serializer_function_ser_schema(
            lambda part, info: part.dump(changed=info.exclude_defaults, given=info.exclude_unset), info_arg=True
        )
        return core_schema.no_info_plain_validator_function(self.validate, serialization=dump)

    def __get_pydantic_json_schema__(self, *_: Any) -> dict[str, str]:
        """A mark, which `karolos.specification.schema` replaces."""
        return {"kind": self.kind}

    def validate(self, value: object) -> Part:
        """Convert a mapping with `name` and settings. Raises ValidationError at paths below this field."""
        if isinstance(value, Part):
            return value
        noun = singular(self.kind)
        what = f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"
        if not isinstance(value, dict):
            number = "a number, " if self.kind == "distributions" else ""
            raise PydanticCustomError("part_type", f"should be {number}the name of {what}, or a mapping with `name`")
        if "name" not in value:
            raise _at_name("missing_name", f"should name {what}", value)
        name = value["name"]
        if not isinstance(name, str):
            raise _at_name("name_type", f"should be the name of {what}", name)
        try:
            plugin = load(self.kind, name)
        except UsageError as error:
            raise _at_name("unknown_name", error.what, name, error.hint) from None
        settings = validate_strictly(plugin.Settings, {key: entry for key, entry in value.items() if key != "name"})
        leaves = list(_leaves(settings.model_dump()))
        # numpy, torch and databases cannot hold larger integers
        size = PydanticCustomError("integer_size", "should be an integer of at most 64 bits")
        hint = "leave it out and let the plugin read an environment variable, or give that one's name: $NAME"
        text = {"message": "looks like a secret, and records show settings", "hint": hint}
        secret = PydanticCustomError("secret", "{message}", text)
        wrong = {path: size for path, leaf in leaves if isinstance(leaf, int) and not -(1 << 63) <= leaf < 1 << 63}
        wrong |= {path: secret for path, leaf in (*leaves, *_leaves(value)) if _looks_secret(path, leaf)}
        if errors := [InitErrorDetails(type=kind, loc=path, input=0) for path, kind in wrong.items()]:
            raise ValidationError.from_exception_data("Part", errors)
        return Part(self.kind, name, settings)


def _leaves(value: object, path: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], object]]:
    """Path and value of all that is neither a mapping nor a list."""
    if not isinstance(value, dict | list | tuple):
        yield path, value
        return
    for key, entry in value.items() if isinstance(value, dict) else enumerate(value):
        yield from _leaves(entry, (*path, key))


def _looks_secret(path: tuple[str | int, ...], leaf: object) -> bool:
    """Whether a value looks like a secret, by its key or by itself."""
    key = next((step for step in reversed(path) if isinstance(step, str)), "")
    return isinstance(leaf, SecretStr) or recorded(leaf, key) != leaf


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
