"""Launchers: start runs and follow them, in this process, on this machine and on others."""
