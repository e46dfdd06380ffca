"""Matrices of transfers: every source is tested and fine-tuned on every target; metrics and the report."""
