"""Measurements next to other libraries, from a checkout: `python -m bench NAME`. Not part of the installed package."""
