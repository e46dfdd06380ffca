"""Measurements next to other libraries, run from a checkout: `python -m bench NAME`. The package does not hold them."""
