"""The talking head for tests of faces, and where its feature points are.

The reference was placed by hand: positions were read off rendered pictures of the first frame, from the front and from
the side, with a grid over them and without the points that the detection finds; the depth of each is that of the
surface there. Readings are good to about 1.5 % of the face's height.
"""

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpqem.usd.read.open_stage import find_meshes, open_stage
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.read.skeleton_poses import StagePoses

SCENE = Path(__file__).parents[2] / "scenes" / "talking_head.usdc"

REFERENCE = {
    "head_top": (0.00, 11.60, -1.30),
    "nose_top": (0.00, 0.35, 8.75),
    "nose_tip": (0.00, -3.60, 10.98),
    "nose_bottom": (0.00, -4.86, 9.30),
    "upper_lip": (0.00, -6.23, 9.25),
    "lip_contact": (0.00, -6.81, 9.09),
    "lower_lip": (0.00, -7.24, 9.16),
    "lip_bottom": (0.00, -8.61, 8.36),
    "chin": (0.00, -9.82, 8.62),
    "throat": (0.00, -10.35, 4.40),
    "head_side_left": (8.45, -1.59, -2.06),
    "head_side_right": (-8.45, -1.58, -2.06),
    "nose_side_left": (2.00, -3.86, 8.35),
    "nose_side_right": (-2.00, -3.86, 8.35),
    "eye_inner_left": (2.03, 0.09, 7.74),
    "eye_inner_right": (-2.03, 0.09, 7.74),
    "eye_outer_left": (4.43, -0.02, 7.35),
    "eye_outer_right": (-4.43, -0.02, 7.34),
    "eye_socket_left": (3.16, 1.14, 7.83),
    "eye_socket_right": (-3.16, 1.14, 7.82),
    "brow_inner_left": (2.11, 1.78, 8.35),
    "brow_inner_right": (-2.11, 1.78, 8.35),
    "cheek_left": (5.11, -2.18, 7.07),
    "cheek_right": (-5.11, -2.18, 7.07),
    "mouth_corner_left": (2.53, -6.76, 8.19),
    "mouth_corner_right": (-2.53, -6.76, 8.19),
    "upper_lip_left": (1.26, -6.34, 9.07),
    "upper_lip_right": (-1.26, -6.34, 9.09),
    "lower_lip_left": (1.26, -7.29, 8.94),
    "lower_lip_right": (-1.26, -7.29, 8.94),
}
# From the chin to the hair: half as much again as from the chin to the root of the nose.
FACE_HEIGHT = 1.5 * float(np.linalg.norm(np.subtract(REFERENCE["nose_top"], REFERENCE["chin"])))


@cache
def talking_head() -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Every fourth frame of the scene, (12, V, 3), and its faces (N, 3)."""
    stage = open_stage(SCENE)
    source = MeshSource(find_meshes(stage, ()).prims[0], StagePoses(stage))
    mesh = source.read(source.authored_times[::4])
    return mesh.points, mesh.faces
