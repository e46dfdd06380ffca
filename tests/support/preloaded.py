"""What the server of worker processes has done before they fork from it: imports, and kernels read from their cache."""

from contextlib import suppress

from karolos import registry
from karolos.plugins.inspection import pair

with suppress(ImportError):
    import pybullet  # noqa: F401
environment = pair("panda", "pick_place")
environment.reset(0)
environment.close()
registry._scan.cache_clear()  # a test may install more
