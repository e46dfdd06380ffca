"""Environments: robots with tasks and their randomization, gymnasium in both directions, toys."""
