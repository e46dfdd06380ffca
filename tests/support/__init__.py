"""Shared by several tests: sample specs, runs and sweeps, fake parts, comparisons."""
