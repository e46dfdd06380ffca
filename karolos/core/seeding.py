"""One SeedSequence tree for every random number of a run: run -> part -> index.

Each part has its own generator, so an additional random number in one part does not change the others.
Nodes are addressed by name and number. With `spawn` the streams would depend on the order of creation.
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
        """The node at `keys` below this one, e.g. child("environment", 3)."""
        numbers = tuple(zlib.crc32(key.encode()) if isinstance(key, str) else key for key in keys)
        return SeedTree(self.entropy, self.path + numbers)

    def sequence(self) -> SeedSequence:
        return SeedSequence(self.entropy, spawn_key=self.path)

    def generator(self) -> Generator:
        return np.random.Generator(np.random.PCG64(self.sequence()))

    def integer(self) -> int:
        """A seed of 63 bits, e.g. for torch or an environment's reset."""
        return int(self.sequence().generate_state(1, np.uint64)[0] >> np.uint64(1))


def generator_state(generator: Generator) -> dict[str, str]:
    """The state of a PCG64 generator for `load_generator_state`, as text because its numbers have 128 bits."""
    inner = dict(generator.bit_generator.state)
    numbers = {**inner.pop("state"), "has_uint32": inner["has_uint32"], "uinteger": inner["uinteger"]}
    return {name: str(int(number)) for name, number in numbers.items()}


def load_generator_state(generator: Generator, state: Mapping[str, str]) -> None:
    """Set a generator to a state from `generator_state`."""
    numbers = {name: int(text) for name, text in state.items()}
    generator.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": numbers["state"], "inc": numbers["inc"]},
        "has_uint32": numbers["has_uint32"],
        "uinteger": numbers["uinteger"],
    }
