"""Plans: sweeps, suites and matrices of transfers. Their runs are ordinary runs. Only `study` uses Optuna."""
