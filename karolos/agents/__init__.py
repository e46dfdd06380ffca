"""Algorithms, one file each, with the losses, networks and optimisers they are made of."""

from .inputs import Normaliser

__all__ = ["Normaliser"]
