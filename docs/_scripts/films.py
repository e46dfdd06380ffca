"""Films of the gallery: docs/films/<spec>.gif, of each policy that ships.

python docs/_scripts/films.py [NAME...]   make these films, or all
"""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

from PIL import Image

from karolos.evaluation.changed_spec import load_player
from karolos.evaluation.playing import play
from karolos.records import RunFolder, shipped
from karolos.report.video import pictures_per_second, with_caption, write_gif

FILMS = Path(__file__).parents[1] / "films"
SIZE = (320, 240)
HOLD, EPISODES, COLOURS = 16, 2, 192
"""Pictures of the end of an episode, episodes, colours."""


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
    pictures, rate = [], pictures_per_second(environment)
    try:
        for moment in play(environment, player.policy, episodes=EPISODES, seed=player.spec.testing.seed):
            text, failed = "success" if moment.success else "", moment.over and not moment.success
            for picture in environment.film(round(rate / environment.rate) if moment.step else 1, *SIZE):
                pictures.append(with_caption(picture, text, success=moment.success, failed=failed))
            pictures += pictures[-1:] * (HOLD * moment.over)
    finally:
        environment.close()
    FILMS.mkdir(exist_ok=True)
    film = FILMS / f"{name}.gif"
    write_gif(film, pictures, 1000 / rate, colours=COLOURS, comment=f"policy {sha256(name)}")
    return film


if __name__ == "__main__":
    for one in sys.argv[1:] or shipped.shipped_names():
        path = make(one)
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")
