"""Distributions, and domain randomization of the parameters that robots and tasks declare."""
