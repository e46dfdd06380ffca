"""A filter as a whole: read from text, asked of runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ...errors import UsageError
from .conditions import Node
from .grammar import Parser
from .tokens import refuse

LONGEST = 10_000
"""Characters of a filter."""


@dataclass(frozen=True)
class Filter:
    """A parsed filter."""

    text: str
    root: Node

    @property
    def keys(self) -> frozenset[str]:
        return frozenset(comparison.key for comparison in self.root.comparisons())

    def matches(self, values: Mapping[str, Any]) -> bool:
        """Whether a run with these values by key fits; keys that are missing are null."""
        return self.root.matches(values)

    def refuse_unknown(self, known: Callable[[str], bool], closest: Callable[[str], str | None]) -> None:
        """Raise a UsageError at the first key that is not known.

        Args:
            known: whether a key is one.
            closest: the key that one is most like, if any.
        """
        for comparison in self.root.comparisons():
            if not known(comparison.key):
                like = closest(comparison.key)
                refuse(
                    f"no run has {comparison.key!r}",
                    comparison.column,
                    f"did you mean {like}?" if like else "`karolos runs show RUN` shows what there is",
                )


def parse(text: str) -> Filter:
    """Read a filter.

    Raises:
        UsageError: it cannot be read; says in which column, from 1, and what is allowed there.
    """
    if len(text) > LONGEST:
        raise UsageError(f"the filter has {len(text):,} characters", hint=f"up to {LONGEST:,} are read")
    return Filter(text, Parser(text).read())
