"""The `transfer` of a spec: between which settings policies are transferred, and how."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, StringConstraints, model_validator
from pydantic import Field as Setting

from ..core import Settings

Mode = Literal["zero_shot", "fine_tune", "scratch"]
VARIANT_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,23}$"
"""Names of variants are parts of run folders."""
VARIANT_KEYS = ("robot", "task", "environment")
"""Keys of a spec below which variants differ."""
FINE_TUNE_KEYS = ("agent", "buffer", "demonstrations", "training", "testing.interval", "testing.final_episodes")
"""Keys of a spec below which fine-tuning differs from training from scratch."""


def _below(allowed: tuple[str, ...], what: str) -> AfterValidator:
    """Checks the key of a setting. An error of a key is reported where the key stands."""

    def check(key: str) -> str:
        if not f"{key}.".startswith(tuple(f"{one}." for one in allowed)):
            raise ValueError(f"{what} cannot change {key}, only {', '.join(allowed)}")
        return key

    return AfterValidator(check)


VariantKey = Annotated[str, _below(VARIANT_KEYS, "a variant")]
FineTuneKey = Annotated[str, _below(FINE_TUNE_KEYS, "fine_tune")]


class Transfer(Settings):
    """A matrix: each variant is a source of policies and a target for the policies of the others."""

    robots: tuple[str, ...] | None = Setting(None, description="names of the robots to transfer between")
    variants: dict[Annotated[str, StringConstraints(pattern=VARIANT_PATTERN)], dict[VariantKey, Any]] | None = Setting(
        None, description="instead of robots: name -> settings, e.g. mujoco: {environment.engine: mujoco}"
    )
    modes: tuple[Mode, ...] = Setting(
        ("zero_shot", "fine_tune", "scratch"),
        description="zero_shot: test a source's policy on the target; fine_tune: train it on there; "
        "scratch: compare fine-tuning with the target's own training",
    )
    fine_tune: dict[FineTuneKey, Any] = Setting(
        {}, description="settings of fine-tuning that differ from the spec's, e.g. training.steps: 100000"
    )
    threshold: float = Setting(0.95, gt=0, le=1, description="success ratio for the time to threshold")

    @model_validator(mode="after")
    def _consistent(self) -> Any:
        if (self.robots is None) == (self.variants is None):
            raise ValueError("takes one of robots and variants")
        for name in self.robots or ():
            if self.robots is not None and self.robots.count(name) > 1:
                raise ValueError(f"names the robot {name} twice")
        seen: list[tuple[str, Mapping[str, Any]]] = []
        for name, settings in self.settings.items():
            twin = next((other for other, known in seen if known == settings), None)
            if twin is not None:
                raise ValueError(f"the variants {twin} and {name} have the same settings")
            seen.append((name, settings))
        if len(seen) < 2:
            raise ValueError(f"needs two {'robots' if self.robots is not None else 'variants'} or more")
        if len(set(self.modes)) < len(self.modes):
            raise ValueError("names a mode twice")
        if not {"zero_shot", "fine_tune"} & set(self.modes):
            raise ValueError("transfers nothing: add zero_shot or fine_tune to modes")
        if self.fine_tune and "fine_tune" not in self.modes:
            raise ValueError("fine_tune is a budget that no mode uses: add fine_tune to modes, or remove it")
        return self

    @property
    def settings(self) -> dict[str, dict[str, Any]]:
        """Variant -> its settings by key path."""
        if self.robots is not None:
            return {name: {"robot.name": name} for name in self.robots}
        return self.variants or {}

    def place(self, variant: str) -> str:
        """The key path in the spec that makes a variant."""
        return "transfer.robots" if self.robots is not None else f"transfer.variants.{variant}"
