"""Environments: robots with tasks, gymnasium in both directions, toys."""
