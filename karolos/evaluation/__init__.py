"""Policies judged: test episodes, scores of scripted and random policies, playing, tests under other conditions."""
