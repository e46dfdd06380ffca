"""The data that environments, buffers and agents exchange, and the interfaces of these parts.

Conventions: SI units (m, s, kg, N, rad), quaternions x y z w, float32 arrays where memory is shared or stored, any
number of leading axes (none for one environment, one for several). An episode ends as `terminated` (the value of the
next state is 0) or `truncated` (the next state has a value). Continuous actions are in [-1, 1].
"""

from .agent import Agent
from .arrays import Array, BoolArray, FloatArray, State
from .buffer import Buffer
from .environment import Environment, Expert
from .experience import Batch, Experience, Rollout, Step, Transitions
from .orchestrator import BuildEnvironment, Failure, Orchestrator, Received
from .settings import AgentSettings, Settings
from .signature import Discrete, Field, GoalRule, Kind, Layout, Measure, Signature, random_actions

__all__ = [
    "Agent",
    "AgentSettings",
    "Array",
    "Batch",
    "BoolArray",
    "Buffer",
    "BuildEnvironment",
    "Discrete",
    "Environment",
    "Experience",
    "Expert",
    "Failure",
    "Field",
    "FloatArray",
    "GoalRule",
    "Kind",
    "Layout",
    "Measure",
    "Orchestrator",
    "Received",
    "Rollout",
    "Settings",
    "Signature",
    "State",
    "Step",
    "Transitions",
    "random_actions",
]
