"""Sweeps: searching a spec's settings, trial by trial. `search.Search` is the way in; Optuna's only home is `study`."""
