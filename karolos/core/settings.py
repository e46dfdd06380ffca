"""Base classes of the settings of plugins."""

from __future__ import annotations

from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, model_validator
from pydantic import Field as Setting

from .. import registry  # noqa: F401  (repairs what pydantic asks when the first model is made)


class Settings(BaseModel):
    """Base of every plugin's nested `Settings`: frozen, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


LATER: Any = {"later": True}
"""`json_schema_extra` of a setting added after 0.2: its default does not belong to an experiment's identity."""


def without_later(settings: BaseModel, dumped: dict[str, Any]) -> dict[str, Any]:
    """Dumped settings without the `LATER` ones at their default: a spec of 0.2 keeps its hash."""
    kept = dict(dumped)
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        if field.json_schema_extra == LATER and value == field.get_default():
            kept.pop(name, None)
        elif isinstance(value, BaseModel) and isinstance(kept.get(name), dict):
            kept[name] = without_later(value, kept[name])
    return kept


class AgentSettings(Settings):
    """Base of every agent's nested `Settings`."""

    start_from: str | None = Setting(
        None, description="start from the weights of this run or shipped policy (id or folder), without its optimisers"
    )
    start_checkpoint: Literal["best", "last"] = Setting("best", description="checkpoint of that run")
    start_sha256: str | None = Setting(
        None,
        pattern="^[0-9a-f]{64}$",
        description="sha256 of that checkpoint's agent; null: not checked, and filled in when the run starts",
    )

    @model_validator(mode="after")
    def _start_is_whole(self) -> Self:
        if self.start_from is None and self.start_sha256 is not None:
            raise ValueError("start_sha256 needs start_from")
        return self

    def identity(self) -> dict[str, Any]:
        """The settings that change results. The start is identified by its content, not by its path."""
        return self.model_dump(mode="json", exclude={"start_from", "start_checkpoint"})
