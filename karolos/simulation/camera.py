"""Pictures of a world with PyBullet's software renderer: no display and no graphics card needed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core import Array
from .body import Vector

SKY_TOP, SKY_BOTTOM = (168.0, 186.0, 206.0), (232.0, 236.0, 240.0)


@dataclass(frozen=True)
class Camera:
    """Where a picture is taken from: `distance` m away from `target`, at angles in degrees."""

    target: Vector = (0.27, 0.0, 0.34)
    distance: float = 1.75
    yaw: float = 42.0
    pitch: float = -20.0
    field_of_view: float = 33.0


def picture(api: Any, client: int, size: tuple[int, int], camera: Camera) -> Array:
    """(height, width, 3) uint8. The renderer has no antialiasing."""
    width, height = size
    view = api.computeViewMatrixFromYawPitchRoll(
        camera.target, camera.distance, camera.yaw, camera.pitch, 0.0, 2, physicsClientId=client
    )
    projection = api.computeProjectionMatrixFOV(camera.field_of_view, width / height, 0.1, 10.0)
    image = api.getCameraImage(
        width,
        height,
        view,
        projection,
        lightDirection=(1.5, -1.4, 3.0),
        lightDistance=3.5,
        lightColor=(1.0, 0.99, 0.97),
        lightAmbientCoeff=0.6,
        lightDiffuseCoeff=0.42,
        lightSpecularCoeff=0.05,
        shadow=1,
        renderer=api.ER_TINY_RENDERER,
        physicsClientId=client,
    )
    pixels: Array = np.asarray(image[2], np.uint8).reshape(height, width, 4)[..., :3].copy()
    nothing = np.asarray(image[4]).reshape(height, width) < 0
    sky = np.linspace(SKY_TOP, SKY_BOTTOM, height).astype(np.uint8)
    pixels[nothing] = np.broadcast_to(sky[:, None], pixels.shape)[nothing]
    return pixels
