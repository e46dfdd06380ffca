"""The vocabulary of karolos: what flows between environments, buffers and agents, and the interfaces of the parts.

Conventions, said once: SI units (m, s, kg, N, rad), quaternions x y z w, float32 arrays in memory that is shared or
stored, any number of leading axes (none for one environment, one for several). An episode ends as `terminated` (the
world has no future: no value beyond) or `truncated` (time is up: the value goes on). Continuous actions lie in [-1, 1].
"""

from .agent import Agent
from .arrays import Array, BoolArray, FloatArray, State
from .buffer import Buffer
from .environment import Environment
from .experience import Batch, Experience, Rollout, Step, Transitions
from .goals import GoalRule
from .layout import Discrete, Field, Layout
from .orchestrator import Failure, Orchestrator, Received
from .settings import AgentSettings, Settings
from .signature import Signature, random_actions

__all__ = [
    "Agent",
    "AgentSettings",
    "Array",
    "Batch",
    "BoolArray",
    "Buffer",
    "Discrete",
    "Environment",
    "Experience",
    "Failure",
    "Field",
    "FloatArray",
    "GoalRule",
    "Layout",
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
