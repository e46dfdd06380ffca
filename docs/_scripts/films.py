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
from karolos.report.video import with_caption

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
    spec, environment, policy = load_player(RunFolder.open(shipped.FOLDER / name))
    pictures, every = [], round(environment.rate / RATE)
    try:
        for moment in play(environment, policy, episodes=EPISODES, seed=spec.testing.seed):
            if moment.step % every and not moment.over:
                continue
            large = Image.fromarray(environment.render(SCALE * SIZE[0], SCALE * SIZE[1]))
            small = np.asarray(large.resize(SIZE, Image.Resampling.LANCZOS))
            text = "success" if moment.success else ""
            small = with_caption(small, text, success=moment.success, failed=moment.over and not moment.success)
            pictures += [Image.fromarray(small)] * (HOLD if moment.over else 1)
    finally:
        environment.close()
    palette = _palette(pictures)
    frames = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    FILMS.mkdir(exist_ok=True)
    film = FILMS / f"{name}.gif"
    milliseconds, comment = round(1000 * every / environment.rate), f"policy {sha256(name)}"
    frames[0].save(film, save_all=True, append_images=frames[1:], duration=milliseconds, loop=0, comment=comment)
    return film


def _palette(pictures: list[Image.Image]) -> Image.Image:
    """Colours for all pictures. Each colour counts once, so that small objects keep theirs."""
    seen = np.unique(np.concatenate([np.asarray(one).reshape(-1, 3) >> 2 for one in pictures[::8]]), axis=0) << 2
    return Image.fromarray(seen[None].astype(np.uint8)).quantize(COLOURS)


if __name__ == "__main__":
    for one in sys.argv[1:] or shipped.shipped_names():
        path = make(one)
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")
