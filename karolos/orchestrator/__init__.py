"""Environments over processes and threads: actions go out, steps come back through shared memory."""
