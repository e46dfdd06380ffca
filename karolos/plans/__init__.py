"""Plans: sweeps, suites and matrices of transfers. Their runs are ordinary runs. Optuna is used in `study` only."""
