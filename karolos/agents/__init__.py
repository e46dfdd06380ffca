"""Algorithms, one file each, and their common parts: losses, networks, optimisers."""

from .inputs import Normaliser

__all__ = ["Normaliser"]
