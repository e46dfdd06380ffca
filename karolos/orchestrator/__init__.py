"""Spreads environments over processes and threads. Actions and steps go through shared memory."""
