"""A task without an expert: a cube goes into a bin."""
