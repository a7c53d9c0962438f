"""Which way a face looks: as the caller says, or found from the mesh.

A face is symmetric, so its plane of symmetry comes first: of many planes through the middle, the one whose mirror image
lies nearest, fitted once more to the closest points (as in Podolak et al. 2006, without their voting). Within the plane
every direction is tried as forward, with up on either side; where it is right, most feature points are found.
All trials start from the principal axes of the mesh, so that a turned mesh gives the same points.
"""

from __future__ import annotations

import numpy as np

from warpqem.errors import OptionError
from warpqem.face.detect import FoundFace, find_midline, find_spots
from warpqem.face.skin_regions import FaceSkin
from warpqem.face.spots import Missing, Spot

__all__ = ["axes_of", "find_face"]

AXES = {f"{sign}{letter}": value for value, sign in ((1.0, "+"), (-1.0, "-")) for letter in "xyz"}

# Normals that are tried for the plane of symmetry, over a half sphere.
NORMALS = 64
# Of these planes so many are fitted further, in so many rounds, on so many points.
FITTED, FIT_ROUNDS, FIT_POINTS = 4, 40, 1500
# Closest points that are farther than this quantile have no partner: necks and cuts need not be symmetric.
PARTNERS = 0.8
# Directions that are tried as forward by their profile, and how many of them are looked at whole.
DIRECTIONS, LOOKED_AT = 36, 6
# Directions with this part of the best evidence are as good, if they differ by less than a right angle.
ALIKE, LIKE_AXES = 0.85, 1.0


def axes_of(up: str, forward: str) -> np.ndarray:
    """(3, 3) unit vectors to the person's left, up and forward, from the names of axes.

    Raises:
        OptionError: a name that is none, or both on one axis.
    """
    vectors = []
    for option, name in (("up", up), ("forward", forward)):
        if name not in AXES:
            raise OptionError(f"{option} {name!r}: expected one of {', '.join(AXES)}")
        vector = np.zeros(3)
        vector["xyz".index(name[1])] = AXES[name]
        vectors.append(vector)
    if up[1] == forward[1]:
        raise OptionError(f"up {up!r} and forward {forward!r} lie on one axis")
    return np.stack([np.cross(vectors[0], vectors[1]), *vectors])


def find_face(points: np.ndarray, skin: FaceSkin) -> tuple[FoundFace | None, np.ndarray]:
    """The face in points (F, V, 3), and its axes (3, 3) to the left, up and forward; no face where none is found."""
    first = points[0]
    normal, across = _symmetry(first, skin.vertices)
    other = np.cross(normal, across)
    trials = []
    for angle in np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS):
        forward = np.cos(angle) * across + np.sin(angle) * other
        for side in (normal, -normal):
            axes = np.stack([side, np.cross(forward, side), forward])
            midline = find_midline(first, skin, axes, strip=True)
            trials.append((-1.0 if midline is None else _evidence(midline.spots), axes))
    # The first of equals stays first.
    trials.sort(key=lambda trial: -trial[0])
    looked = [(find_spots(points[:1], skin, axes), axes) for evidence, axes in trials[:LOOKED_AT] if evidence >= 0.0]
    faces = [(_evidence(face.spots), axes) for face, axes in looked if face is not None]
    if not faces:
        return None, trials[0][1]
    most, chosen = max(faces, key=lambda entry: entry[0])
    # Points are found over a range of nods: the middle of it. Other faces than the best look elsewhere.
    alike = [axes for evidence, axes in faces if evidence >= ALIKE * most and (axes * chosen).sum() > LIKE_AXES]
    forward = np.mean([axes[2] for axes in alike], axis=0)
    forward /= np.linalg.norm(forward)
    middle = np.stack([chosen[0], np.cross(forward, chosen[0]), forward])
    found = find_spots(points, skin, middle)
    return (found, middle) if found is not None else (find_spots(points, skin, chosen), chosen)


def _evidence(spots: dict[str, Spot | Missing]) -> float:
    return sum(spot.confidence for spot in spots.values() if isinstance(spot, Spot))


def _symmetry(points: np.ndarray, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal of the plane of symmetry, and a direction within it that turns with the mesh."""
    from scipy.spatial import cKDTree

    place = points[vertices] - points[vertices].mean(axis=0)
    _, principal = np.linalg.eigh(place.T @ place)
    # The longer side of the mesh gives an axis its sign, so that it turns with the mesh.
    principal = principal.T * np.where(((place @ principal) ** 3).sum(axis=0) < 0.0, -1.0, 1.0)[:, None]
    sample = place[:: max(1, len(place) // FIT_POINTS)]
    tree = cKDTree(place)

    def distance(normal: np.ndarray, offset: float) -> tuple[float, np.ndarray, np.ndarray]:
        mirrored = sample - 2.0 * np.outer(sample @ normal - offset, normal)
        away, partner = tree.query(mirrored)
        return float(np.minimum(away, np.quantile(away, PARTNERS)).mean()), away, partner

    tried = [(distance(normal, 0.0)[0], index, normal) for index, normal in enumerate(_half_sphere() @ principal)]
    best = (np.inf, principal[0])
    for _, _, normal in sorted(tried, key=lambda entry: entry[:2])[:FITTED]:
        offset = 0.0
        for _ in range(FIT_ROUNDS):
            _, away, partner = distance(normal, offset)
            kept = away <= np.quantile(away, PARTNERS)
            normal, offset = _mirror_plane(sample[kept], place[partner[kept]])
        measure = distance(normal, offset)[0]
        if measure < best[0]:
            best = (measure, normal)
    normal = best[1]
    across = principal[int(np.argmin(np.abs(principal @ normal)))]
    across = across - (across @ normal) * normal
    return normal, across / np.linalg.norm(across)


def _mirror_plane(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, float]:
    """Normal and offset of the plane that mirrors points a (n, 3) onto points b (n, 3) best."""
    middle_a, middle_b = a.mean(axis=0), b.mean(axis=0)
    # What the mean of a mirroring and its inverse turns round is the normal.
    scatter = (a - middle_a).T @ (b - middle_b)
    _, vectors = np.linalg.eigh(scatter + scatter.T)
    normal = vectors[:, 0]
    return normal, float(normal @ (middle_a + middle_b) / 2)


def _half_sphere() -> np.ndarray:
    """(n, 3) unit vectors, evenly over a half sphere (Fibonacci)."""
    index = np.arange(NORMALS) + 0.5
    height = 1.0 - index / NORMALS
    turn = np.pi * (1.0 + 5.0**0.5) * index
    around = np.sqrt(1.0 - height**2)
    return np.stack([around * np.cos(turn), around * np.sin(turn), height], axis=1)
