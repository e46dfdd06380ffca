"""`karolos.make`: from a spec, a run or a policy to the gymnasium environment that it describes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import NoSuchRunError
from ..registry import closest
from ..specification import Spec, load_spec
from ..specification.files import SHIPPED, SPEC_SUFFIXES, find_spec, shipped_specs
from ..store.query import find_folder, index
from .policies import spec_of

if TYPE_CHECKING:
    from ..environments.gymnasium.export import GoalEnv


def make(
    what: str | Path | Spec,
    *,
    randomize: bool = False,
    render_mode: str | None = None,
    width: int = 640,
    height: int = 480,
    runs: str | Path = "runs",
    database: str | None = None,
) -> GoalEnv:
    """The gymnasium environment that a spec describes, with all its settings.

    Args:
        what: a spec file, or the name of a spec that ships, such as panda_push; a run, as `karolos.load` takes it; or a
            Spec. A file comes first, then a spec that ships, then a run. `shipped:panda_push` is the run that ships.
        randomize: whether to draw the spec's `randomization` at each reset, as training does and tests do not.
        render_mode: None, "rgb_array", or "human": a window, if the engine has one.
        width: of a picture in pixels.
        height: of a picture in pixels.
        runs: the runs folder.
        database: URL of the database; by default the one in the runs folder.

    Raises:
        SpecError: the spec is invalid.
        UsageError: there is neither such a spec nor such a run, the environment has no goals, or its engine is not
            installed.
        RunError: the run is damaged.
    """
    from ..environments.gymnasium.export import SpecEnv  # noqa: PLC0415  (imports gymnasium)

    spec = what if isinstance(what, Spec) else _spec_of(str(what), runs, database)
    return SpecEnv(spec, randomize=randomize, render_mode=render_mode, width=width, height=height)


def _spec_of(what: str, runs: str | Path, database: str | None) -> Spec:
    if find_spec(what)[0].is_file() or what.startswith(SHIPPED) or what.endswith(SPEC_SUFFIXES):
        return load_spec(what)
    with index(runs, database) as store:
        try:
            return spec_of(find_folder(what, store, runs))
        except NoSuchRunError as error:
            like = closest(what, shipped_specs())
            hint = f"did you mean {like!r}, a spec that ships?" if like else error.hint
            raise NoSuchRunError(f"{what!r} is neither a spec nor a run", hint=hint) from error
