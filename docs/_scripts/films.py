"""Films of the gallery: docs/films/<spec>.gif, of each policy that ships.

python docs/_scripts/films.py [NAME...]   make these films, or all
"""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from karolos.evaluation.changed_spec import load_player
from karolos.evaluation.playing import play
from karolos.records import RunFolder, shipped
from karolos.report.video import with_caption, write_gif

FILMS = Path(__file__).parents[1] / "films"
SIZE = (288, 216)
SCALE = 2
"""Pictures are drawn larger and made smaller, which smooths edges."""
RATE, HOLD, EPISODES, COLOURS = 12, 8, 2, 96
"""Pictures per second, pictures of the end of an episode, episodes, colours."""


def sha256(name: str) -> str:
    """Of a policy that ships, in hexadecimal digits."""
    return hashlib.sha256((shipped.FOLDER / name / "policy.npz").read_bytes()).hexdigest()


def played_in(film: Path) -> str:
    """The sha256 of the policy.npz that plays in a film, as its comment says."""
    return Image.open(film).info["comment"].decode().removeprefix("policy ")


def make(name: str) -> Path:
    """Film the test episodes of a policy that ships."""
    player = load_player(RunFolder.open(shipped.FOLDER / name))
    environment = player.environment
    pictures, every = [], round(environment.rate / RATE)
    try:
        for moment in play(environment, player.policy, episodes=EPISODES, seed=player.spec.testing.seed):
            if moment.step % every and not moment.over:
                continue
            large = Image.fromarray(environment.render(SCALE * SIZE[0], SCALE * SIZE[1]))
            small = np.asarray(large.resize(SIZE, Image.Resampling.LANCZOS))
            text = "success" if moment.success else ""
            small = with_caption(small, text, success=moment.success, failed=moment.over and not moment.success)
            pictures += [small] * (HOLD if moment.over else 1)
    finally:
        environment.close()
    FILMS.mkdir(exist_ok=True)
    film = FILMS / f"{name}.gif"
    write_gif(film, pictures, 1000 * every / environment.rate, colours=COLOURS, comment=f"policy {sha256(name)}")
    return film


if __name__ == "__main__":
    for one in sys.argv[1:] or shipped.shipped_names():
        path = make(one)
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")
