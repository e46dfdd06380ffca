"""Specs: from YAML or a dictionary to a validated, frozen and hashed description of an experiment."""

from .files import parse_settings, to_yaml
from .load import load_spec, spec_from_dict, spec_of_trial, spec_of_variant, spec_without
from .model import Spec, TestingSettings, TrainingSettings
from .parts import Part, Recipe
from .sweep import Sweep, Transfer

__all__ = [
    "Part",
    "Recipe",
    "Spec",
    "Sweep",
    "TestingSettings",
    "TrainingSettings",
    "Transfer",
    "load_spec",
    "parse_settings",
    "spec_from_dict",
    "spec_of_trial",
    "spec_of_variant",
    "spec_without",
    "to_yaml",
]
