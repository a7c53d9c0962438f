"""Colours that show where a test mesh lies off its reference."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from warpqem.arguments.number_input import real_number
from warpqem.measure.checked_meshes import check_same_frame_count, check_sequence
from warpqem.measure.closest_points import ClosestPointSearch
from warpqem.measure.collapsed import collapsed_in_either, distances_from_hull
from warpqem.runtime.device import on_device, resolve_device

__all__ = ["COLOR_MAP", "distance_colors", "vertex_distances"]

# Five stops of the viridis map (van der Walt and Smith, 2015, CC0), sRGB-encoded, evenly spaced from distance zero
# (dark blue-violet) over teal and green to the full scale (yellow). Lightness grows evenly along it, so that the order
# of two colours can be seen, in grey and by colour-blind readers too.
COLOR_MAP = np.array(
    [
        [0.267, 0.005, 0.329],
        [0.229, 0.322, 0.546],
        [0.128, 0.567, 0.551],
        [0.369, 0.789, 0.383],
        [0.993, 0.906, 0.144],
    ]
)


def _linear_light(encoded: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Linear values of sRGB-encoded ones (IEC 61966-2-1)."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def _colors(fraction: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """Linear colours (..., 3) for fractions of the scale; beyond 0 and 1 the end colours."""
    stops = np.linspace(0, 1, len(COLOR_MAP))
    encoded = np.stack([np.interp(fraction, stops, COLOR_MAP[:, channel]) for channel in range(3)], axis=-1)
    return _linear_light(encoded).astype(np.float32)


@on_device
def vertex_distances(
    reference_points: npt.ArrayLike,
    reference_faces: npt.ArrayLike,
    test_points: npt.ArrayLike,
    test_faces: npt.ArrayLike,
    *,
    device: str | None = None,
) -> npt.NDArray[np.float64]:
    """Distance of each test vertex to the reference surface in each frame.

    Args:
        reference_points: (F, V, 3) or (V, 3).
        reference_faces: (N, 3) integers.
        test_points: (F, V', 3) or (V', 3), with as many frames.
        test_faces: (N', 3) integers.
        device: Warp device name; None takes "cuda:0" where there is one, else "cpu".

    Returns:
        (F, V'), in % of the reference's bounding-box diagonal in the frame. Where either mesh is collapsed to a point
        or a line, the distance from the reference's bounding box, or from the line that it is, in % of the largest
        diagonal.

    Raises:
        MeshShapeError, NonFinitePointError, FaceIndexError, DegenerateMeshError, DeviceError: as in ``compare``.
    """
    reference = check_sequence(reference_points, reference_faces, "reference")
    test = check_sequence(test_points, test_faces, "test")
    check_same_frame_count(reference, test)
    search = ClosestPointSearch(reference.faces, resolve_device(device), "reference")
    collapsed = collapsed_in_either(reference, test)
    distance = np.empty(test.points.shape[:2])
    diagonals = [0.0]
    for frame in np.flatnonzero(~collapsed).tolist():
        own = reference.points[frame, reference.used]
        low, high = own.min(axis=0), own.max(axis=0)
        diagonals.append(float(np.linalg.norm(high - low)))
        p, q = ((mesh.points[frame] - (low + high) / 2) / diagonals[-1] for mesh in (reference, test))
        distance[frame] = 100 * search.closest(p, q, frame).distance
    # Where all frames are collapsed, the reference has no size: that of the test mesh stands for it.
    size = max(diagonals) or float(np.linalg.norm(np.ptp(test.points[:, test.used], axis=1), axis=1).max()) or 1.0
    for frame in np.flatnonzero(collapsed).tolist():
        box = reference.points[frame, reference.used]
        distance[frame] = 100 * distances_from_hull(test.points[frame], box) / size
    return distance


def distance_colors(
    reference_points: npt.ArrayLike,
    reference_faces: npt.ArrayLike,
    test_points: npt.ArrayLike,
    test_faces: npt.ArrayLike,
    *,
    scale: float | None = None,
    device: str | None = None,
) -> tuple[npt.NDArray[np.float32], float]:
    """Heat map: a colour per test vertex and frame for its distance to the reference surface.

    The colours run from dark blue-violet at distance zero over teal and green to yellow at the scale and beyond
    (COLOR_MAP, even steps of lightness). They are linear Rec. 709 values, as USD's displayColor wants them.

    Args:
        reference_points: (F, V, 3) or (V, 3).
        reference_faces: (N, 3) integers.
        test_points: (F, V', 3) or (V', 3), with as many frames.
        test_faces: (N', 3) integers.
        scale: distance of the last colour in % of the frame's reference diagonal, above 0; None takes the largest
            distance that occurs.
        device: Warp device name; None takes "cuda:0" where there is one, else "cpu".

    Returns:
        Colours (F, V', 3) float32, and the scale used in %: 0 where none was given and no vertex is off the reference.

    Raises:
        MeshShapeError, NonFinitePointError, FaceIndexError, DegenerateMeshError, DeviceError: as in ``compare``.
        OptionError: scale is not a positive number.

    Examples:
        >>> import numpy as np, trimesh, warpqem
        >>> ball = trimesh.creation.icosphere(subdivisions=3)
        >>> points = np.stack([ball.vertices * (1, 1, 1 + 0.2 * step) for step in range(4)])
        >>> result = warpqem.simplify(points, ball.faces, ratio=0.1)
        >>> colors, scale = warpqem.measure.distance_colors(points, ball.faces, result.points, result.faces)
        >>> colors.shape
        (4, 66, 3)
    """
    if scale is not None:
        scale = real_number(scale, "scale", "a positive number", lambda value: 0.0 < value < np.inf)
    distance = vertex_distances(reference_points, reference_faces, test_points, test_faces, device=device)
    used = float(distance.max()) if scale is None else float(scale)
    return _colors(distance / used if used > 0 else distance), used
