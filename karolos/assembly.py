"""From a spec to the objects it names, and whether they go together."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from .core import Agent, Buffer, Orchestrator, Signature
from .environments.build import build_environment
from .errors import KarolosError, UsageError
from .registry import load
from .seeding import SeedTree
from .spec import Spec


def make_orchestrator(spec: Spec, *, randomize: bool) -> Orchestrator:
    """The spec's environments, laid out as it says."""
    part = spec.orchestrator
    made: Orchestrator = load("orchestrators", part.name)(part.settings, spec.recipe(randomize=randomize))
    return made


def make_agent(spec: Spec, signature: Signature, seeds: SeedTree) -> Agent:
    """The spec's agent for these environments, on the spec's device. `seeds` is the run's."""
    from .agents.device import resolve_device  # noqa: PLC0415  (imports torch)

    part, device = spec.agent, resolve_device(spec.training.device)
    made: Agent = load("agents", part.name)(part.settings, signature, seeds.child("agent"), device)
    return made


def make_buffer(spec: Spec, signature: Signature, seeds: SeedTree, *, environments: int, discount: float) -> Buffer:
    """The spec's buffer, with room for every environment. `seeds` is the run's."""
    part = spec.buffer
    made: Buffer = load("buffers", part.name)(
        part.settings, signature, seeds.child("buffer"), environments=environments, discount=discount
    )
    return made


def check_parts(spec: Spec) -> None:
    """Put the spec's parts together once, so that those that cannot work are refused before anything runs.

    Builds one environment (no world is simulated), the agent and the buffer, and lets them go.

    Raises:
        UsageError: two parts do not go together; names the setting and where it was set.
        KarolosError: a plugin or the machine stands in the way.
    """
    with _located(spec):
        environment = build_environment(spec.recipe(randomize=True))
        try:
            agent = make_agent(spec, environment.signature, SeedTree(0))
            size = getattr(spec.orchestrator.settings, "size", 1)
            make_buffer(spec, environment.signature, SeedTree(0), environments=size, discount=agent.discount)
        finally:
            environment.close()


@contextmanager
def _located(spec: Spec) -> Iterator[None]:
    """Say where the setting that an error names was set: file:line:column, or the override."""
    try:
        yield
    except KarolosError as error:
        origin = _origin(spec, error.where)
        if origin is None:
            raise
        raise UsageError(f"{error.where}: {error.what}", where=origin, hint=error.hint) from error


def _origin(spec: Spec, path: str | None) -> str | None:
    """Where the setting `path`, or the first one below it, was set; None for defaults and what is no setting."""
    if path is None:
        return None
    origins = (origin for key, origin in spec.origins.items() if key == path or key.startswith(f"{path}."))
    return next((origin for origin in origins if origin != "default"), None)
