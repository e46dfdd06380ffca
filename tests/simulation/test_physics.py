"""What docs/physics.md says of bodies without a robot holds in both engines."""

import runpy
from pathlib import Path

import pytest
from support.rig import ENGINES

measure = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "_scripts" / "physics.py"))["measure"]
LIMITS: dict[str, dict[str, tuple[float, float]]] = {
    "sliding at .3 m/s": {"hop, mm": (0, 0.3), "carried by the floor": (1, 1), "distance, error": (-0.05, 0.05)},
    "sliding at 1.5 m/s": {"hop, mm": (0, 0.3), "carried by the floor": (1, 1), "distance, error": (-0.05, 0.05)},
    "slope of 25 degrees (friction .5 holds)": {"creep in .5 s, mm": (0, 0.1)},
    "slope of 28 degrees": {"acceleration, error": (-0.05, 0.05)},
    "slope of 30 degrees": {"acceleration, error": (-0.05, 0.05)},
    "fall from .5 m": {"depth, mm": (0, 2), "rebound, mm": (0, 10)},
    "cylinder on a slope of 10 degrees": {"acceleration, error": (-0.02, 0.02)},
    "peg pressed with 25 N in .5 mm of play": {"depth, share of the play": (0, 0.1)},
    "pressed with 98 N": {"depth, mm": (0, 2)},
    "pendulum, 10 s": {"energy, change": (-0.01, 0.01)},
    "peg in a frame with 1 mm of play": {"left above the ground, mm": (-0.1, 0.1), "depth into walls, mm": (-0.1, 0.1)},
    "stack of three, 10 s": {"drift, mm": (0, 5), "sinking, mm": (0, 1)},
}
WORSE = {
    ("sliding at .3 m/s", "distance, error"): (-0.08, 0.0),
    ("slope of 25 degrees (friction .5 holds)", "creep in .5 s, mm"): (0, 1.5),
    ("cylinder on a slope of 10 degrees", "acceleration, error"): (-0.35, 0.0),
    ("fall from .5 m", "depth, mm"): (0, 13),
    ("fall from .5 m", "rebound, mm"): (0, 100),
}
"""What PyBullet does worse."""


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("trial", LIMITS)
def test_bodies_move_as_they_must(engine, trial):
    for quantity, found in measure(engine, trial).items():
        low, high = LIMITS[trial][quantity]
        if engine == "bullet":
            low, high = WORSE.get((trial, quantity), (low, high))
        assert low <= found <= high, f"{quantity}: {found:.3g}"
