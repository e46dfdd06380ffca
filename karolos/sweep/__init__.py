"""Searches over a spec's settings: trials are ordinary runs. Optuna is used in `study` only."""
