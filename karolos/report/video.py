"""Writes pictures as a film. The only module that imports imageio."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from io import BytesIO
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import system
from ..errors import UsageError
from ..system.files import writing

if TYPE_CHECKING:
    from ..core import Environment, Moment

FORMATS = (".mp4", ".gif")
RATE = 24
"""Smallest number of pictures per second, if an environment takes fewer control steps."""
BEGINNING_SECONDS = 8
"""Part of a film that TensorBoard shows."""
OUTCOME_SECONDS = 0.7
"""Time for which a film shows the outcome of an episode."""
TEXT, SUCCESS, FAILURE = "#20262c", "#22a559", "#c8452f"


def check_video_path(path: Path) -> None:
    """Raise a UsageError for a format that cannot be written or a missing folder."""
    if path.suffix.lower() not in FORMATS:
        raise UsageError(f"cannot record {path.name!r}", hint=f"name a file that ends in {' or '.join(FORMATS)}")
    if not path.parent.is_dir():
        raise UsageError(f"there is no folder {path.parent} to record into")


def with_caption(picture: NDArray[np.uint8], text: str, *, success: bool, failed: bool) -> NDArray[np.uint8]:
    """The picture (height, width, 3) with text and a frame: green at the goal, red for a failed episode."""
    from PIL import Image, ImageDraw, ImageFont  # noqa: PLC0415

    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    height, width = picture.shape[:2]
    size = max(8, height // 26)
    draw.text((size, size), text, fill=TEXT, font=ImageFont.load_default(size))
    if success or failed:
        edge = max(1, height // 80)
        draw.rectangle((0, 0, width - 1, height - 1), outline=SUCCESS if success else FAILURE, width=edge)
    return np.asarray(image)


def pictures_per_second(environment: Environment) -> float:
    """Frame rate of a film in real time: the control rate, or its first multiple of at least `RATE`."""
    return environment.rate * ceil(RATE / environment.rate - 1e-9)


def pictures(moments: Iterable[Moment], width: int, height: int) -> Iterator[NDArray[np.uint8]]:
    """Pictures of each control step that show whether the goal is reached. An episode's last one stays for a while."""
    for moment in moments:
        environment = moment.environment
        count = round(pictures_per_second(environment) / environment.rate)
        failed = moment.over and not moment.success and environment.signature.has_success
        outcome = "success" if moment.success else "no success" if failed else ""
        text = f"episode {moment.episode + 1}   step {moment.step}   {outcome}"
        for picture in environment.film(count if moment.step else 1, width, height):
            shown = with_caption(picture, text, success=moment.success, failed=failed)
            yield shown
        for _ in range(moment.over * round(OUTCOME_SECONDS * count * environment.rate)):
            yield shown


def write_film(path: Path, moments: Iterable[Moment], environment: Environment, size: tuple[int, int]) -> bytes:
    """Film played episodes, as `write_video`; returns the beginning as a GIF with half the size and rate."""
    beginning: list[NDArray[np.uint8]] = []
    rate = pictures_per_second(environment)

    def drawn() -> Iterator[NDArray[np.uint8]]:
        for number, picture in enumerate(pictures(moments, *size)):
            if number % 2 == 0 and number < BEGINNING_SECONDS * rate:
                beginning.append(picture[::2, ::2])
            yield picture

    write_video(path, drawn(), rate)
    gif = BytesIO()
    write_gif(gif, beginning, 2000 / rate)
    return gif.getvalue()


def write_video(path: Path, pictures: Iterable[NDArray[np.uint8]], frames_per_second: float) -> None:
    """Write pictures (height, width, 3) to an .mp4 or .gif, whole or not at all.

    Raises UsageError if the format cannot be written or the folder is missing, MachineError if the file cannot.
    """
    import imageio  # noqa: PLC0415  (takes 0.2 s)

    check_video_path(path)
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    with writing(path):
        partial.touch()  # an error before anything is played
        try:
            if path.suffix.lower() == ".gif":
                write_gif(partial, list(pictures), 1000 / frames_per_second)
            else:
                writer: Any = imageio.get_writer(
                    partial, fps=frames_per_second, codec="libx264", quality=8, macro_block_size=2
                )
                with writer:
                    for picture in pictures:
                        writer.append_data(picture)
            partial.replace(path)
        finally:
            system.remove(partial, missing_ok=True)


def write_gif(
    target: Path | BytesIO,
    pictures: Sequence[NDArray[np.uint8]],
    milliseconds: float,
    *,
    colours: int = 256,
    comment: str = "",
) -> None:
    """Write pictures (height, width, 3), each shown for some milliseconds, in the same colours.

    Each shade counts once in the choice of the colours, so that small objects keep theirs. Colours of frames stay.
    """
    from PIL import Image, ImageColor  # noqa: PLC0415

    shades = np.unique(np.concatenate([one.reshape(-1, 3) >> 2 for one in pictures[::8]]), axis=0) << 2
    kept = [ImageColor.getrgb(one) for one in (SUCCESS, FAILURE)]
    palette = Image.fromarray(shades[None].astype(np.uint8)).quantize(colours - len(kept))
    palette.putpalette([*(palette.getpalette() or ()), *(value for colour in kept for value in colour)])
    first, *others = (Image.fromarray(one).quantize(palette=palette, dither=Image.Dither.NONE) for one in pictures)
    options: dict[str, Any] = {"duration": round(milliseconds), "loop": 0, "comment": comment}
    first.save(target, "GIF", save_all=True, append_images=others, **options)
