"""Plans: sweeps, suites and matrices of transfers, with ordinary runs; scores of robots. Only `study` uses Optuna."""
