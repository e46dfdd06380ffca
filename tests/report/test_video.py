"""Films as GIF: the frame that says how an episode ended keeps its colour among many others."""

from io import BytesIO

import numpy as np
from PIL import Image, ImageColor

from karolos.report.video import SUCCESS, with_caption, write_gif


def test_the_frame_of_a_success_is_green_in_a_film_of_many_blues():
    blues = np.random.default_rng(0).integers(0, 255, (60, 80, 3)) * (0.2, 0.5, 1.0)
    picture = blues.astype(np.uint8)
    film = BytesIO()
    write_gif(film, [picture, with_caption(picture, "", success=True, failed=False)], 100, colours=192)
    shown = Image.open(film)
    shown.seek(1)
    assert shown.convert("RGB").getpixel((0, 0)) == ImageColor.getrgb(SUCCESS)
