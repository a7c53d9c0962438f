"""A cape in the wind: an open cloth held at the collar, as points sampled in time, with a texture seam."""

import numpy as np
from numpy.typing import NDArray

from scenes.scene import Scene, TextureCoordinates

# Length of the cape from collar to hem and widths of both, in metres.
LENGTH = 1.35
COLLAR_WIDTH = 0.42
HEM_WIDTH = 1.30
COLLAR_HEIGHT = 1.50
LINING = (0.42, 0.028, 0.030)
TRIM = (0.70, 0.47, 0.12)
# Gap between the two islands in the texture's unit square.
ISLAND_GAP = 0.04


def build(face_count: int = 5000, frame_count: int = 24, seed: int = 11) -> Scene:
    """Return the cape with about `face_count` faces in a loop of `frame_count` frames.

    Metres, +y up; the wind blows along -z. The seed draws the diagonals of the quads and the phases of the waves.
    """
    generator = np.random.default_rng(seed)
    # The cape is about 1.35 times as long as it is wide in the middle; an even count of columns has a middle one.
    columns = 2 * round(np.sqrt(face_count / 2.0 / 1.35) / 2.0)
    rows = round(face_count / 2.0 / columns)
    across, down = np.meshgrid(np.linspace(-1.0, 1.0, columns + 1), np.linspace(0.0, 1.0, rows + 1))
    faces = _triangles(rows, columns, generator)
    phases = generator.uniform(0.0, 2.0 * np.pi, size=4)
    samples = [_blown(across, down, frame / frame_count, phases) for frame in range(frame_count)]
    return Scene(
        name="Cape",
        points=_hanging(across, down).reshape(-1, 3).astype(np.float32),
        faces=faces,
        colors=_dye(across, down),
        frame_count=frame_count,
        point_samples=np.stack(samples).reshape(frame_count, -1, 3).astype(np.float32),
        texture_coordinates=_two_islands(across, down, faces, rows, columns),
    )


def _triangles(rows: int, columns: int, generator: np.random.Generator) -> NDArray[np.int32]:
    """Split each quad along a diagonal drawn by lot, so that the mesh has no direction of its own.

    Faces wind counter-clockwise seen from the back of the wearer, the outside of the cape.
    """
    a = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    b, c, d = a + 1, a + columns + 1, a + columns + 2
    rising = generator.random(len(a)) < 0.5
    first = np.where(rising[:, None], np.stack([a, b, c], axis=1), np.stack([a, b, d], axis=1))
    second = np.where(rising[:, None], np.stack([b, d, c], axis=1), np.stack([a, d, c], axis=1))
    return np.stack([first, second], axis=1).reshape(-1, 3).astype(np.int32)


def _half_width(down: NDArray) -> NDArray[np.float64]:
    return 0.5 * (COLLAR_WIDTH + (HEM_WIDTH - COLLAR_WIDTH) * down**0.8)


def _collar(across: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the collar's line around the shoulders."""
    angle = across * 0.9
    radius = 0.5 * COLLAR_WIDTH / np.sin(0.9)
    return radius * np.sin(angle), COLLAR_HEIGHT - 0.05 * across**2, radius * (1.0 - np.cos(angle))


def _hanging(across: NDArray, down: NDArray) -> NDArray[np.float64]:
    """Return the rest points ``(R, C, 3)``: the cape hanging from the collar in still air."""
    x, y, z = _collar(across)
    spread = across * (_half_width(down) - 0.5 * COLLAR_WIDTH)
    hem = 0.06 * (1.0 - across**2) * down**2
    return np.stack([x + spread, y - LENGTH * down - hem, z * (1.0 - down)], axis=-1)


def _blown(across: NDArray, down: NDArray, time: float, phases: NDArray) -> NDArray[np.float64]:
    """Return the points ``(R, C, 3)`` at the share `time` of the loop.

    Each thread from collar to hem keeps its length: the cape is drawn by the slope of its threads, integrated from
    the pinned collar. Waves run towards the hem and grow on the way.
    """
    turn = 2.0 * np.pi * time
    growth = down**1.2
    # Slope of a thread above the horizontal, in radians: it leaves the shoulders steeply and the wind lifts it.
    slope = -1.15 + 0.75 * np.minimum(1.0, 1.6 * down) + 0.10 * growth * np.sin(turn + phases[0])
    slope = slope + 0.62 * growth * np.sin(2.0 * np.pi * 1.55 * down - 2.0 * turn + 1.1 * across + phases[1])
    slope = slope + 0.22 * growth * np.sin(2.0 * np.pi * 3.2 * down - 3.0 * turn - 2.3 * across + phases[2])
    step = np.diff(down, axis=0)
    middle = 0.5 * (slope[1:] + slope[:-1])
    zero = np.zeros((1, down.shape[1]))
    back = LENGTH * np.concatenate([zero, np.cumsum(step * np.cos(middle), axis=0)])
    rise = LENGTH * np.concatenate([zero, np.cumsum(step * np.sin(middle), axis=0)])
    x, y, z = _collar(across)
    # Folds from shoulder to hem gather the width and travel sideways slowly.
    fold = 0.055 * growth * np.sin(2.0 * np.pi * 1.75 * across + turn + phases[3] + 1.5 * down)
    sway = 0.10 * growth * np.sin(turn + phases[0] - 2.0 * down)
    spread = across * (0.86 * _half_width(down) - 0.43 * COLLAR_WIDTH)
    return np.stack([x + spread + sway, y + rise + fold, z - back - 0.5 * fold], axis=-1)


def _two_islands(
    across: NDArray, down: NDArray, faces: NDArray[np.int32], rows: int, columns: int
) -> TextureCoordinates:
    """Lay the two halves of the cape side by side in the unit square, the left one turned by 180 degrees.

    The middle column of vertices lies in both islands, with two texture coordinates each: the seam.
    """
    vertex = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    half = columns // 2
    shape = across * _half_width(down) / _half_width(np.ones(1))
    width = 0.5 - 0.5 * ISLAND_GAP
    right = np.stack([(1.0 + shape[:, : half + 1]) * width, down[:, : half + 1]], axis=-1)
    left = np.stack([1.0 - shape[:, half:] * width, 1.0 - down[:, half:]], axis=-1)
    values = np.concatenate([right.reshape(-1, 2), left.reshape(-1, 2)])
    in_right = np.full(vertex.size, -1, dtype=np.int64)
    in_right[vertex[:, : half + 1].ravel()] = np.arange(vertex[:, : half + 1].size)
    in_left = np.full(vertex.size, -1, dtype=np.int64)
    in_left[vertex[:, half:].ravel()] = right.shape[0] * right.shape[1] + np.arange(vertex[:, half:].size)
    is_right = (in_right[faces] >= 0).all(axis=1)
    indices = np.where(is_right[:, None], in_right[faces], in_left[faces])
    return TextureCoordinates(values.astype(np.float32), indices.astype(np.int32))


def _dye(across: NDArray, down: NDArray) -> NDArray[np.float32]:
    """Return the linear colours ``(V, 3)``: red with a golden trim along the border."""
    border = (np.abs(across) > 0.93) | (down > 0.965)
    return np.where(border[..., None], TRIM, LINING).reshape(-1, 3).astype(np.float32)
