"""What several tests share: parts that count, runs and sweeps made by hand, plugins that misbehave."""
