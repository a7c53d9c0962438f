"""The galloping quadruped: a closed, skinned mesh."""

import numpy as np
from numpy.typing import NDArray

from scenes import gallop, quadruped_shape
from scenes.diffusion import diffuse, strongest_influences
from scenes.implicit import Points, surface
from scenes.remesh import well_shaped
from scenes.scene import Binding, Scene

# Grid step of marching cubes in metres: three samples across the thinnest part, the ears.
SPACING = 0.014
# The skin blends from bone to bone over this share of the radius of the part.
BLEND_SHARE = 0.5

COAT = (0.26, 0.105, 0.042)
DARK = (0.030, 0.020, 0.016)
HORN = (0.11, 0.085, 0.065)
WHITE = (0.75, 0.71, 0.66)


def build(face_count: int = 16000, frame_count: int = 48, seed: int = 7) -> Scene:
    """Return the quadruped with about `face_count` faces galloping two strides in a loop of `frame_count` frames.

    Metres, +y up, facing +z. The seed draws the dapples of the coat and the differences between the strides.
    """
    generator = np.random.default_rng(seed)
    body = quadruped_shape.body()
    points, faces = surface(body, quadruped_shape.LOWER, quadruped_shape.UPPER, SPACING)
    points, faces, _ = well_shaped(body, points, faces, quadruped_shape.edge_size, face_count, set())
    bones = gallop.skeleton()
    indices, weights = _skin_weights(points, faces, bones.names)
    colors = _coat(points, faces, generator)
    poses = gallop.gallop(bones, frame_count, generator)
    return Scene(
        name="Quadruped",
        points=points.astype(np.float32),
        faces=faces.astype(np.int32),
        colors=colors.astype(np.float32),
        frame_count=frame_count,
        binding=Binding(bones, poses, indices, weights),
    )


def _nearest_solid(points: Points) -> tuple[list[quadruped_shape.Solid], NDArray[np.int64]]:
    solids = quadruped_shape.solids()
    # Rounded so that a point as near to two solids goes to the first of them on every machine.
    distance = np.round(np.stack([solid.field()(points) for solid in solids], axis=1), 6)
    return solids, distance.argmin(axis=1)


def _skin_weights(
    points: Points, faces: NDArray, names: tuple[str, ...]
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Give each vertex to the bone of the nearest solid and let the labels diffuse over the surface."""
    solids, nearest = _nearest_solid(points)
    bone = np.array([names.index(solid.bone) for solid in solids])[nearest]
    reach = BLEND_SHARE * np.array([max(solid.start_radius, solid.end_radius) for solid in solids])[nearest]
    labels = np.eye(len(names))[bone]
    return strongest_influences(diffuse(points, faces, labels, reach))


def _coat(points: Points, faces: NDArray, generator: np.random.Generator) -> NDArray[np.float64]:
    """Return the linear colours of a bay: brown with dapples, dark mane, tail, muzzle and legs, a white blaze."""
    solids, nearest = _nearest_solid(points)
    x, y, z = points.T
    dark = np.zeros(len(points))
    mane = [i for i, s in enumerate(solids) if s in quadruped_shape.MANE]
    tail = [i for i, s in enumerate(solids) if s.bone.startswith("tail")]
    dark[np.isin(nearest, mane) | (np.isin(nearest, tail) & (y < 1.36))] = 1.0
    dark = np.maximum(dark, np.clip((0.62 - y) / 0.2, 0.0, 1.0))
    dark = np.maximum(dark, np.clip((z - 1.36) / 0.08, 0.0, 0.8))
    dark = diffuse(points, faces, dark[:, None], np.full(len(points), 0.008))[:, 0]
    mottle = diffuse(points, faces, generator.normal(size=(len(points), 1)), np.full(len(points), 0.03))[:, 0]
    coat = np.array(COAT) * (1.0 + 0.09 * np.clip(mottle / mottle.std(), -2.0, 2.0))[:, None]
    color = coat * (1.0 - dark[:, None]) + np.array(DARK) * dark[:, None]
    color[y < 0.085] = HORN
    # A white blaze from the forehead to the nose, its edge soft so that it does not show the triangles.
    blaze = np.exp(-((x / 0.030) ** 6) - ((z - 1.27) / 0.14) ** 8)[:, None] * (y > 1.60)[:, None]
    color = color * (1.0 - blaze) + np.array(WHITE) * blaze
    eye = (((points * [0, 1, 1] - [0, 1.803, 1.158]) ** 2).sum(axis=1) < 0.022**2) & (np.abs(x) > 0.06)
    color[eye] = (0.012, 0.008, 0.006)
    return color
