"""The data that environments, buffers and agents exchange, and the interfaces of these parts.

Conventions: SI units (m, s, kg, N, rad), quaternions x y z w, float32 arrays where memory is shared or stored, any
number of leading axes (none for one environment, one for several). An episode ends as `terminated` (the value of the
next state is 0) or `truncated` (the next state has a value). Continuous actions are in [-1, 1].
"""

from .agent import Agent, Deployed, JointLayers, Layer, Output
from .buffer import Buffer
from .environment import Environment, Expert, Moment
from .experience import Batch, Experience, Rollout, State, Step, Transitions
from .orchestrator import BuildEnvironment, Failure, Orchestrator, Received
from .seeding import Generator, SeedTree, generator_state, load_generator_state
from .settings import AgentSettings, Settings
from .signature import (
    Array,
    BoolArray,
    Discrete,
    Field,
    FloatArray,
    GoalRule,
    Kind,
    Layout,
    Measure,
    Signature,
    layout_differences,
    random_actions,
)

__all__ = [
    "Agent",
    "AgentSettings",
    "Array",
    "Batch",
    "BoolArray",
    "Buffer",
    "BuildEnvironment",
    "Deployed",
    "Discrete",
    "Environment",
    "Experience",
    "Expert",
    "Failure",
    "Field",
    "FloatArray",
    "Generator",
    "GoalRule",
    "JointLayers",
    "Kind",
    "Layer",
    "Layout",
    "Measure",
    "Moment",
    "Orchestrator",
    "Output",
    "Received",
    "Rollout",
    "SeedTree",
    "Settings",
    "Signature",
    "State",
    "Step",
    "Transitions",
    "generator_state",
    "layout_differences",
    "load_generator_state",
    "random_actions",
]
