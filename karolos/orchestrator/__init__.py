"""Environments over processes and threads: actions in, steps out, in shared memory."""
