"""MuJoCo as the physics engine. No other package imports mujoco."""
