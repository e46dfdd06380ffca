"""Films of gallery and home page: docs/films/<name>.gif, of each shipped policy and of GUESTS.

python docs/_scripts/films.py [NAME...]   make these films, or all
"""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

from PIL import Image

from karolos.evaluation.playing import load_player, play
from karolos.records import RunFolder, shipped
from karolos.report.video import pictures_per_second, with_caption, write_gif

FILMS = Path(__file__).parents[1] / "films"
DESK_ARM = FILMS.parents[1] / "examples" / "karolos-desk-arm" / "src" / "karolos_desk_arm" / "desk_arm.urdf"
GUESTS = {"desk_arm_pick": ("ur5_pick", f"robot={{name: urdf, file: {DESK_ARM}}}")}
"""Film -> a shipped policy and the arm that it never saw."""
SIZE = (320, 240)
HOLD, EPISODES, COLOURS = 16, 2, 192
"""Pictures of the end of an episode, episodes, colours."""


def sha256(name: str) -> str:
    """SHA-256 of a shipped policy, in hexadecimal digits."""
    return hashlib.sha256((shipped.FOLDER / name / "policy.npz").read_bytes()).hexdigest()


def played_in(film: Path) -> str:
    """The sha256 of the policy.npz that plays in a film, from its comment."""
    return Image.open(film).info["comment"].decode().removeprefix("policy ")


def make(name: str) -> Path:
    """Film test episodes of a shipped policy, or of a guest."""
    policy, *overrides = GUESTS.get(name, (name,))
    with load_player(RunFolder.open(shipped.FOLDER / policy), overrides=overrides) as player:
        environment, seed, pictures = player.environment, player.spec.testing.seed, []
        rate = pictures_per_second(environment)
        for moment in play(environment, player.policy, episodes=EPISODES, seed=seed):
            text, failed = "success" if moment.success else "", moment.over and not moment.success
            for picture in environment.film(round(rate / environment.rate) if moment.step else 1, *SIZE):
                pictures.append(with_caption(picture, text, success=moment.success, failed=failed))
            pictures += pictures[-1:] * (HOLD * moment.over)
    FILMS.mkdir(exist_ok=True)
    film = FILMS / f"{name}.gif"
    write_gif(film, pictures, 1000 / rate, colours=COLOURS, comment=f"policy {sha256(policy)}")
    return film


if __name__ == "__main__":
    for one in sys.argv[1:] or (*shipped.shipped_names(), *GUESTS):
        path = make(one)
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")
