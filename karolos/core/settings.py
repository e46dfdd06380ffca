"""What the settings of plugins have in common."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, model_validator
from pydantic import Field as Setting


class Settings(BaseModel):
    """Base of every plugin's nested `Settings`: frozen, and every key is known."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class AgentSettings(Settings):
    """Base of every agent's nested `Settings`."""

    start_from: str | None = Setting(
        None, description="run id or folder of a run whose agent to go on from: what it learned, not its optimisers"
    )
    start_checkpoint: Literal["best", "last"] = Setting("best", description="which of that run's checkpoints")
    start_sha256: str | None = Setting(
        None,
        pattern="^[0-9a-f]{64}$",
        description="of that checkpoint's agent; null: whatever is found, and noted here",
    )

    @model_validator(mode="after")
    def _start_is_whole(self) -> Any:
        if self.start_from is None and self.start_sha256 is not None:
            raise ValueError("start_sha256 says what start_from must find: give start_from too")
        return self

    def identity(self) -> dict[str, Any]:
        """What results depend on: what was started from, wherever it lies."""
        return self.model_dump(mode="json", exclude={"start_from", "start_checkpoint"})
