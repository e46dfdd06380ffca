"""Updates as a GPU likes them: captured once, and launched as a whole ever after.

An update of networks of this size is three hundred operations of a few microseconds each, and a GPU waits for Python to
launch every one. A CUDA graph keeps them all, with the memory that they read and write, and launches them as one. On a
CPU an update runs as it is written.

What a capture keeps is operations on memory. Hence the rules for an update: every number that changes from one to
the next lies in a tensor that stays where it is (statistics, moments, learning rates); what Python counts, it counts
outside; where Python decides (what to watch, whose turn it is), each outcome is a kind of update with a capture of
its own.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch

from .inputs import Fed
from .networks import MLP

Metrics = dict[str, Any]
Update = Callable[[Fed], Metrics]

RUNS_BEFORE = 3
"""Updates of a kind that run as they are written before one is captured: libraries choose their kernels and take their
memory in the first."""


class Graph(Protocol):
    """A capture."""

    def capture(self, work: Callable[[], Metrics]) -> Metrics:
        """Keep what this does, without doing it; the tensors in which a replay leaves its results."""

    def replay(self) -> None:
        """Do it."""


class CudaGraph:
    """A capture on a GPU: torch.cuda.CUDAGraph, with a generator.

    Args:
        generator: draws what the work draws at random; goes on from replay to replay.
    """

    def __init__(self, generator: torch.Generator) -> None:
        self._graph = torch.cuda.CUDAGraph()
        self._graph.register_generator_state(generator)

    def capture(self, work: Callable[[], Metrics]) -> Metrics:
        torch.cuda.synchronize()
        with torch.cuda.graph(self._graph):
            return work()

    def replay(self) -> None:
        self._graph.replay()


@dataclass
class _Captured:
    """One kind of update.

    Args:
        graph: what to replay; None: not captured yet.
        fed: where it looks for its batch.
        found: where it leaves its metrics.
        runs: updates before it was captured.
    """

    graph: Graph | None = None
    fed: Fed | None = None
    found: Metrics | None = None
    runs: int = 0


class GraphedUpdates:
    """Runs the updates of one agent.

    Args:
        device: where it learns.
        networks: that an update changes or rounds.
        generator: that an update draws from.
        graphs: makes an empty graph; by default a CUDA graph on a GPU, and none on a CPU, where nothing is captured.
    """

    def __init__(
        self,
        device: torch.device,
        networks: Sequence[MLP],
        generator: torch.Generator,
        graphs: Callable[[torch.Generator], Graph] | None = None,
    ) -> None:
        self._device = device
        self._networks = networks
        self._generator = generator
        self._graphs = graphs or (CudaGraph if device.type == "cuda" else None)
        self._captures: dict[Hashable, _Captured] = {}

    def run(self, kind: Hashable, fed: Fed, update: Update) -> Metrics:
        """One update; its metrics, as tensors.

        Args:
            kind: all that Python decides in this update. Updates of one kind do the same operations.
            fed: the batch, on the CPU.
            update: what to do with it, on the device.
        """
        if self._graphs is None:
            return update(fed.to(self._device))
        captured = self._captures.setdefault((kind, len(fed.reward)), _Captured())
        if captured.runs < RUNS_BEFORE:
            captured.runs += 1
            return update(fed.to(self._device))
        if captured.graph is None or captured.fed is None or captured.found is None:
            captured.graph = self._graphs(self._generator)
            captured.fed = kept = fed.to(self._device).clone()
            self._touch()
            captured.found = captured.graph.capture(lambda: update(kept))
        else:
            for place, field in zip(captured.fed, fed, strict=True):
                if place is not None and field is not None:
                    place.copy_(field)
        captured.graph.replay()
        self._touch()
        return {name: found.clone() for name, found in captured.found.items()}

    def _touch(self) -> None:
        """Say that parameters have changed: a network that computes rounded ones looks whether they have, and a replay
        changes them unseen. Before a capture, so that each rounds for itself what it uses.
        """
        for network in self._networks:
            network.touch()
