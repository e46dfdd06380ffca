"""How good policies are: test episodes, scripted and random policies, playing, tests under other conditions."""
