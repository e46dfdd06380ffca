"""Pure functions of arrays: densities, intervals, aggregates over seeds."""
