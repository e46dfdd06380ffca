"""The robots that need no file and no number."""

from __future__ import annotations

from karolos.registry import names

ROBOTS = [name for name in names("robots") if name not in ("urdf", "random_arm")]
