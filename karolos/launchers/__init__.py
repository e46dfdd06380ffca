"""Launchers: how the processes of runs are started, on this machine and on others."""
