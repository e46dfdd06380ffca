"""PyBullet as the physics engine. No other package imports pybullet."""
