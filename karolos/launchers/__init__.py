"""Launchers: how runs are started and followed, in this process, on this machine and on others."""
