"""What a generator returns: one animated mesh as plain arrays, and its points baked frame by frame."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenes.skinning import JointPoses, Skeleton, skin


@dataclass(frozen=True)
class BlendShape:
    """Offsets of some vertices: `vertices` ``(K,)`` int32, `offsets` ``(K, 3)`` float32 in scene units."""

    name: str
    vertices: NDArray[np.int32]
    offsets: NDArray[np.float32]


@dataclass(frozen=True)
class Binding:
    """Skin of a mesh: the skeleton, its poses, four joints and weights per vertex ``(V, 4)``."""

    skeleton: Skeleton
    poses: JointPoses
    joint_indices: NDArray[np.int32]
    joint_weights: NDArray[np.float32]


@dataclass(frozen=True)
class BlendAnimation:
    """Blend shapes and their weights over time, `weights` ``(F, S)`` float32."""

    shapes: tuple[BlendShape, ...]
    weights: NDArray[np.float32]


@dataclass(frozen=True)
class TextureCoordinates:
    """Face-varying texture coordinates: `values` ``(T, 2)`` float32, `indices` ``(N, 3)`` int32 into them."""

    values: NDArray[np.float32]
    indices: NDArray[np.int32]


@dataclass(frozen=True)
class Scene:
    """One triangle mesh moving over `frame_count` frames.

    Shapes and units: `points` ``(V, 3)`` float32 rest points in units of `meters_per_unit` metres, +y up;
    `faces` ``(N, 3)`` int32, counter-clockwise from outside; `colors` ``(V, 3)`` float32 linear.
    Motion is the skin `binding` and the blend shapes `blend`, or else the explicit `point_samples` ``(F, V, 3)``.
    """

    name: str
    points: NDArray[np.float32]
    faces: NDArray[np.int32]
    colors: NDArray[np.float32]
    frame_count: int
    meters_per_unit: float = 1.0
    frames_per_second: float = 24.0
    binding: Binding | None = None
    blend: BlendAnimation | None = None
    point_samples: NDArray[np.float32] | None = None
    texture_coordinates: TextureCoordinates | None = field(default=None)

    def baked(self) -> NDArray[np.float32]:
        """Return the points of every frame, ``(F, V, 3)`` float32 in scene units."""
        if self.point_samples is not None:
            return self.point_samples
        points = np.repeat(self.points[None].astype(np.float64), self.frame_count, axis=0)
        if self.blend is not None:
            for column, shape in enumerate(self.blend.shapes):
                points[:, shape.vertices] += self.blend.weights[:, column, None, None] * shape.offsets
        if self.binding is not None:
            b = self.binding
            points = skin(points, b.skeleton, b.poses, b.joint_indices, b.joint_weights)
        return points.astype(np.float32)
