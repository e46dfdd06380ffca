"""Gymnasium in both directions: `adapter` takes its environments, with the `goals` of some; `export` gives ours."""
