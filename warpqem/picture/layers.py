"""Pictures in layers: colours under the light, light on a plain surface, and what the surface covers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.arguments.array_record import ArrayRecord
from warpqem.kernels import render as kernels
from warpqem.picture.look import PLAIN
from warpqem.picture.render import BACKGROUND, PlacedScene, encoded_srgb

__all__ = ["Layers", "empty_layers", "render_layers"]


@dataclass(frozen=True, eq=False, repr=False)
class Layers(ArrayRecord):
    """One picture.

    Attributes:
        textured: (height, width, 3) uint8 sRGB, with the colours and textures of the surface.
        gray: likewise, of a surface of one colour.
        covered: (height, width) float32, the part of each pixel that the surface covers.
    """

    textured: npt.NDArray[np.uint8]
    gray: npt.NDArray[np.uint8]
    covered: npt.NDArray[np.float32]


def render_layers(scene: PlacedScene) -> Layers:
    """Draw them in one go."""
    color = wp.empty(scene.shape, dtype=wp.vec3, device=scene.device)
    light, covered = (wp.empty(scene.shape, dtype=wp.float32, device=scene.device) for _ in range(2))
    scene.launch(kernels.render_layers, [color, light, covered])
    part: npt.NDArray[np.float32] = covered.numpy()
    return Layers(encoded_srgb(color.numpy()), _gray(light.numpy(), part), part)


def empty_layers(shape: tuple[int, int]) -> Layers:
    """A picture (height, width) of nothing."""
    nothing = np.zeros(shape, dtype=np.float32)
    background = _gray(nothing, nothing)
    return Layers(background, background, nothing)


def _gray(light: npt.NDArray[np.float32], covered: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    plain, behind = (np.array(color, dtype=np.float32) for color in (PLAIN, BACKGROUND))
    return encoded_srgb(light[..., None] * plain + (1.0 - covered[..., None]) * behind)
