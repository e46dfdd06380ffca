"""Robots, one file each. No robot knows a task."""
