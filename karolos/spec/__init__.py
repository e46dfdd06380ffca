"""Specs: YAML or a dictionary in, a checked, frozen and hashed description of an experiment out."""

from .load import load_spec
from .model import Spec, Testing, Training
from .recipe import Part, Recipe
from .yaml_text import to_yaml

__all__ = ["Part", "Recipe", "Spec", "Testing", "Training", "load_spec", "to_yaml"]
