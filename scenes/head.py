"""The talking head: an open mesh with blend shapes on a skeleton of neck and head."""

import numpy as np
from numpy.typing import NDArray

from scenes import head_mesh, head_shape, head_shapes
from scenes.diffusion import diffuse
from scenes.head_mesh import HeadMesh
from scenes.scene import Binding, BlendAnimation, Scene
from scenes.skinning import JointPoses, Skeleton, multiply_quaternions, quaternion

SKIN = (0.62, 0.36, 0.25)
LIPS = (0.44, 0.135, 0.115)
INSIDE = (0.16, 0.03, 0.03)
SCLERA = (0.80, 0.79, 0.76)
IRIS = (0.07, 0.13, 0.15)
PUPIL = (0.008, 0.008, 0.01)
BROW = (0.10, 0.055, 0.035)

# "Hello, world", as (share of the clip, half width of the bell, height) of each move of a shape.
_SPEECH = {
    "jawOpen": (
        (0.14, 0.040, 0.50),
        (0.25, 0.050, 0.75),
        (0.37, 0.055, 0.60),
        (0.60, 0.050, 0.45),
        (0.71, 0.055, 0.70),
    ),
    "smile": ((0.15, 0.060, 0.40), (0.26, 0.050, 0.25), (0.90, 0.075, 0.90)),
    "pucker": ((0.40, 0.055, 0.70), (0.56, 0.055, 0.95), (0.66, 0.040, 0.45)),
    "browUp": ((0.20, 0.080, 0.80), (0.71, 0.060, 0.45), (0.90, 0.070, 0.60)),
    "blinkLeft": ((0.05, 0.026, 1.00), (0.47, 0.028, 1.00), (0.86, 0.026, 1.00)),
    "blinkRight": ((0.05, 0.026, 1.00), (0.48, 0.028, 1.00)),
}


def build(face_count: int = 11000, frame_count: int = 48, seed: int = 3) -> Scene:
    """Return the head with about `face_count` faces saying two words in `frame_count` frames.

    Centimetres, +y up, +z out of the face. The seed draws small shifts of the timing and of the head's sway.
    """
    generator = np.random.default_rng(seed)
    mesh = head_mesh.build(face_count)
    shapes = head_shapes.shapes(mesh)
    bones = _skeleton()
    indices, weights = _skin_weights(mesh.points)
    poses = _sway(bones, frame_count, generator)
    return Scene(
        name="Head",
        points=mesh.points.astype(np.float32),
        faces=mesh.faces.astype(np.int32),
        colors=_complexion(mesh).astype(np.float32),
        frame_count=frame_count,
        meters_per_unit=0.01,
        binding=Binding(bones, poses, indices, weights),
        blend=BlendAnimation(shapes, speech([shape.name for shape in shapes], frame_count, generator)),
    )


def speech(names: list[str], frame_count: int, generator: np.random.Generator) -> NDArray[np.float32]:
    """Return the weights ``(F, S)`` of the named shapes over the clip, all in [0, 1]."""
    time = np.arange(frame_count) / (frame_count - 1)
    weights = np.zeros((frame_count, len(names)))
    for column, name in enumerate(names):
        for middle, width, height in _SPEECH[name]:
            # Half a percent of the clip is what two readings of a sentence differ by.
            at = middle + generator.normal(scale=0.005)
            weights[:, column] += height * np.exp(-(((time - at) / width) ** 2))
    # Bells fade out below a thousandth: shapes at rest have weight zero exactly.
    weights[weights < 1e-3] = 0.0
    return np.minimum(weights, 1.0).astype(np.float32)


def _skeleton() -> Skeleton:
    # Base of the neck and the joint of skull and spine, in centimetres.
    translations = np.array([[[0.0, -16.0, -3.6], [0.0, 10.5, 2.0]]], dtype=np.float32)
    rotations = np.zeros((1, 2, 4), dtype=np.float32)
    rotations[..., 0] = 1.0
    return Skeleton(("neck", "head"), np.array([-1, 0], dtype=np.int32), JointPoses(translations, rotations))


def _skin_weights(points: NDArray) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Blend from neck to head across the plane from the throat under the chin to the nape."""
    height = points[:, 1] + 11.0 + 0.5 * (points[:, 2] + 2.0)
    share = np.clip((height + 3.5) / 6.0, 0.0, 1.0)
    share = share * share * (3.0 - 2.0 * share)
    weights = np.zeros((len(points), 4), dtype=np.float32)
    weights[:, 0], weights[:, 1] = 1.0 - share, share
    return np.tile(np.array([0, 1, 0, 0], dtype=np.int32), (len(points), 1)), weights


def _sway(bones: Skeleton, frame_count: int, generator: np.random.Generator) -> JointPoses:
    """Nod with the words and turn slowly to one side and back."""
    time = np.arange(frame_count) / (frame_count - 1)
    phase = generator.uniform(-0.05, 0.05)
    nod = 5.0 * np.sin(2.0 * np.pi * (2.0 * time + phase)) * np.sin(np.pi * time)
    turn = 9.0 * np.sin(2.0 * np.pi * time)
    tilt = 4.0 * np.sin(np.pi * time) ** 2
    rotations = np.repeat(bones.rest.rotations.astype(float), frame_count, axis=0)
    rotations[:, 0] = multiply_quaternions(quaternion((0, 1, 0), 0.4 * turn), quaternion((0, 0, 1), 0.5 * tilt))
    rotations[:, 1] = multiply_quaternions(quaternion((0, 1, 0), 0.6 * turn), quaternion((1, 0, 0), nod))
    translations = np.repeat(bones.rest.translations, frame_count, axis=0)
    return JointPoses(translations, rotations.astype(np.float32))


def _complexion(mesh: HeadMesh) -> NDArray[np.float64]:
    """Return the linear colours of skin, lips, mouth, eyes and brows."""
    points = mesh.points
    x, y, z = points.T
    color = np.tile(np.array(SKIN), (len(points), 1))
    share = np.clip(np.abs(x) / head_shape.MOUTH_HALF_WIDTH, 0.0, 1.0)
    above = y - head_shape.contact_line(x)
    # The lips' red ends just past their thickest line, and runs out to the corners.
    red = (above < 0.80 * (1.0 - 0.75 * share**2)) & (above > -1.0 * (1.0 - 0.75 * share**2))
    color[red & (z > 6.5) & (share < 1.0)] = LIPS
    arch = 1.75 + 0.28 * np.sin(np.clip((np.abs(x) - 1.2) / 3.6, 0.0, 1.0) * np.pi)
    # Hair thins out over the width of the brow, so that its edge does not show the triangles.
    hair = np.exp(-(((y - arch) / 0.34) ** 4) - ((np.abs(x) - 2.9) / 1.75) ** 8)[:, None] * (z > 3.0)[:, None]
    color = color * (1.0 - 0.85 * hair) + 0.85 * hair * np.array(BROW)
    color = diffuse(points, mesh.faces, color, np.full(len(points), 0.10))
    eye = np.stack([np.abs(x), y, z], axis=1) - head_shape.EYE
    bare = np.abs(np.sqrt((eye**2).sum(axis=1)) - head_shape.EYE_RADIUS) < 0.06
    bare &= (head_shape.lid_opening(points) > 0.0) & (eye[:, 2] > 0.0)
    from_pupil = np.sqrt(eye[:, 0] ** 2 + eye[:, 1] ** 2)
    color[bare] = SCLERA
    color[bare & (from_pupil < 0.56)] = IRIS
    color[bare & (from_pupil < 0.26)] = PUPIL
    color[mesh.pocket.ravel()] = INSIDE
    return color
