"""The parts of a spec, the recipe of an environment, and the pydantic field type of a part."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, GetCoreSchemaHandler, SecretStr, ValidationError
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from ..core.settings import without_later
from ..errors import recorded
from ..registry import blaming, find, load
from .tree import leaves

_SIZE = PydanticCustomError("integer_size", "should be an integer of at most 64 bits")
_SECRET = PydanticCustomError(
    "secret",
    "looks like a secret, and records show settings",
    {"hint": "leave it out and let the plugin read an environment variable, or give that one's name: $NAME"},
)


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

    @classmethod
    def of(cls, kind: str, name: str, given: Mapping[str, Any]) -> Part:
        """The part with these settings. Raises UsageError and PluginError as `registry.load`.

        Raises ValidationError if a setting is invalid, an integer too large for numpy, torch and databases, or a
        secret.
        """
        with blaming():
            settings = validate_strictly(load(kind, name).Settings, given)
        values = list(leaves(settings.model_dump(), lists=True))
        wrong = {path: _SIZE for path, value in values if isinstance(value, int) and not -(1 << 63) <= value < 1 << 63}
        for path, value in (*values, *leaves(given, lists=True)):
            key = next((step for step in reversed(path) if isinstance(step, str)), "")
            if isinstance(value, SecretStr) or recorded(value, key) != value:  # it looks like a secret
                wrong[path] = _SECRET
        if errors := [InitErrorDetails(type=error, loc=path, input=0) for path, error in wrong.items()]:
            raise ValidationError.from_exception_data("Part", errors)
        return cls(kind, name, settings)

    @property
    def plugin(self) -> Any:
        """The plugin's class. Raises as `registry.load`."""
        return load(self.kind, self.name)

    @property
    def is_foreign(self) -> bool:
        """Whether another distribution than karolos provides the plugin."""
        return find(self.kind, self.name).distribution != "karolos"

    def make(self, *given: Any, **more: Any) -> Any:
        """An instance of the plugin: its class is called with the settings and the given arguments."""
        return self.plugin(self.settings, *given, **more)

    def dump(self, *, changed: bool = False, given: bool = False) -> dict[str, Any]:
        """Name and settings as in a spec: all, only non-default ones, or only given ones; JSON-able."""
        settings: BaseModel = self.settings
        return {"name": self.name, **settings.model_dump(mode="json", exclude_defaults=changed, exclude_unset=given)}

    def identity(self) -> dict[str, Any]:
        """Name and the settings that change results: `Settings.identity()` if defined, otherwise all."""
        identity = getattr(self.settings, "identity", None)
        found = identity() if callable(identity) else self.settings.model_dump(mode="json")
        return {"name": self.name, **without_later(self.settings, found)}


@dataclass(frozen=True)
class Recipe:
    """The description from which one environment is built."""

    environment: Part
    robot: Part | None = None
    task: Part | None = None
    randomization: tuple[tuple[str, Part], ...] = ()
    """Parameters to sample at each reset ("task.gravity") with their distributions, sorted by name."""


@dataclass(frozen=True)
class OfKind:
    """Marks a field that holds a part of this kind.

    A pydantic union over plugins would import all of them and reject plugins of other packages. `validate` therefore
    lets the plugins validate the parts, and gives them to pydantic as its context, by their paths in the spec.
    """

    kind: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        dump = core_schema.plain_serializer_function_ser_schema(
            lambda part, info: part.dump(changed=info.exclude_defaults, given=info.exclude_unset), info_arg=True
        )
        return core_schema.with_info_plain_validator_function(
            lambda path, info: (info.context or {}).get(path), serialization=dump
        )

    def __get_pydantic_json_schema__(self, *_: Any) -> dict[str, str]:
        """A mark, which `karolos.specification.schema` replaces."""
        return {"kind": self.kind}


def validate_strictly(model: type[BaseModel], value: object, context: object = None) -> Any:
    """Convert plain data to a model without coercion: "5" is not a number, true is not 1; 1e6 is an integer.

    JSON mode lets strict models accept lists for tuples and strings for enumerations.
    """
    return model.model_validate_json(json.dumps(_integers(value)), strict=True, context=context)


def _integers(value: object) -> object:
    """Convert whole floats to integers, which float fields accept too."""
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, dict):
        return {key: _integers(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_integers(entry) for entry in value]
    return value
