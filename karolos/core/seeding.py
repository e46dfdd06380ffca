"""One SeedSequence tree for every random number of a run: run -> part -> index.

A part draws from a generator of its own, so that adding a draw in one leaves every other stream as it was.
The tree is addressed by name and number, never by order of creation: `spawn` would make the streams depend on it.
Source: NumPy's SeedSequence (spawn keys), O'Neill 2015.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

Generator = np.random.Generator
SeedSequence = np.random.SeedSequence


@dataclass(frozen=True)
class SeedTree:
    """A node of the tree. `entropy` is the run's seed, `path` the keys from the root to this node."""

    entropy: int
    path: tuple[int, ...] = ()

    def child(self, *keys: str | int) -> SeedTree:
        """The node below this one that `keys` name, e.g. child("environment", 3)."""
        numbers = tuple(zlib.crc32(key.encode()) if isinstance(key, str) else key for key in keys)
        return SeedTree(self.entropy, self.path + numbers)

    def sequence(self) -> SeedSequence:
        return SeedSequence(self.entropy, spawn_key=self.path)

    def generator(self) -> Generator:
        return np.random.Generator(np.random.PCG64(self.sequence()))

    def integer(self) -> int:
        """A seed of 63 bits, for what takes a number (torch, an environment's reset)."""
        return int(self.sequence().generate_state(1, np.uint64)[0] >> np.uint64(1))


def generator_state(generator: Generator) -> dict[str, str]:
    """What `load_generator_state` needs: the PCG64's numbers as text, because they take 128 bits."""
    inner = dict(generator.bit_generator.state)
    numbers = {**inner.pop("state"), "has_uint32": inner["has_uint32"], "uinteger": inner["uinteger"]}
    return {name: str(int(number)) for name, number in numbers.items()}


def load_generator_state(generator: Generator, state: Mapping[str, str]) -> None:
    """Put a generator back where `generator_state` found another."""
    numbers = {name: int(text) for name, text in state.items()}
    generator.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": numbers["state"], "inc": numbers["inc"]},
        "has_uint32": numbers["has_uint32"],
        "uinteger": numbers["uinteger"],
    }
