"""The robots that need no file."""

from __future__ import annotations

from karolos.registry import names

ROBOTS = [name for name in names("robots") if name != "urdf"]
