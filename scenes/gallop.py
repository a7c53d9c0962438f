"""The skeleton of the quadruped and its gallop.

All turns of the gait are about the x axis. A turn by a positive angle takes a bone that hangs down backwards, a bone
that points forward downwards, and a bone that points up forward.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from scenes.skinning import JointPoses, Skeleton, multiply_quaternions, quaternion, rotation_matrix

# Joint, parent, position in metres (left side of the pairs), end of the bone.
_TRUNK = (
    ("pelvis", None, (0, 1.30, -0.62), (0, 1.36, -0.36)),
    ("loin", "pelvis", (0, 1.36, -0.36), (0, 1.36, -0.10)),
    ("back", "loin", (0, 1.36, -0.10), (0, 1.34, 0.18)),
    ("chest", "back", (0, 1.34, 0.18), (0, 1.32, 0.46)),
    ("neck_low", "chest", (0, 1.32, 0.46), (0, 1.56, 0.70)),
    ("neck_high", "neck_low", (0, 1.56, 0.70), (0, 1.84, 0.98)),
    ("head", "neck_high", (0, 1.84, 0.98), (0, 1.53, 1.45)),
    ("tail_1", "pelvis", (0, 1.38, -0.76), (0, 1.25, -0.985)),
    ("tail_2", "tail_1", (0, 1.25, -0.985), (0, 1.05, -1.045)),
    ("tail_3", "tail_2", (0, 1.05, -1.045), (0, 0.80, -1.07)),
    ("tail_4", "tail_3", (0, 0.80, -1.07), (0, 0.46, -1.05)),
)
_PAIRS = (
    ("ear", "head", (0.056, 1.94, 1.01), (0.074, 2.10, 1.02)),
    ("scapula", "chest", (0.11, 1.42, 0.26), (0.135, 1.14, 0.50)),
    ("humerus", "scapula", (0.135, 1.14, 0.50), (0.150, 0.95, 0.36)),
    ("forearm", "humerus", (0.150, 0.95, 0.36), (0.145, 0.52, 0.405)),
    ("fore_cannon", "forearm", (0.145, 0.52, 0.405), (0.145, 0.195, 0.395)),
    ("fore_pastern", "fore_cannon", (0.145, 0.195, 0.395), (0.145, 0.0, 0.48)),
    ("femur", "pelvis", (0.12, 1.24, -0.56), (0.15, 0.99, -0.43)),
    ("tibia", "femur", (0.15, 0.99, -0.43), (0.145, 0.62, -0.71)),
    ("hind_cannon", "tibia", (0.145, 0.62, -0.71), (0.145, 0.205, -0.67)),
    ("hind_pastern", "hind_cannon", (0.145, 0.205, -0.67), (0.145, 0.0, -0.585)),
)
# Heel and toe of the sole, behind and before the middle of the hoof (metres).
_SOLE = (-0.05, 0.065)

# Phase of a leg's stride at which the keys below hold: touch-down, mid stance, toe-off, folding, swing, reach.
_KEY_PHASES = (0.0, 0.13, 0.27, 0.43, 0.62, 0.82)
# Degrees by which each bone is turned forward (towards the head for a hanging bone) at those phases.
_FORE_KEYS = {
    "scapula": (7, 1, -6, -8, 2, 10),
    "humerus": (18, -6, -22, -22, 10, 30),
    "forearm": (11, 6, -8, 14, 46, 25),
    "fore_cannon": (0, 0, -6, -80, -88, -28),
    "fore_pastern": (6, 26, -8, -55, -48, -14),
}
_HIND_KEYS = {
    "femur": (34, 6, -26, -24, 12, 42),
    "tibia": (-6, -2, 4, -26, -50, -26),
    "hind_cannon": (0, 4, -20, 20, 48, 22),
    "hind_pastern": (8, 26, -8, -50, -48, -12),
}
# Share of the stride at which each hoof touches down: a transverse gallop on the right lead, with a suspension of
# the gathered body after the leading fore leg has left the ground.
_TOUCH_DOWN = {"hind_left": 0.0, "hind_right": 0.12, "fore_left": 0.36, "fore_right": 0.50}
_STANCE = 0.27
STRIDES = 2


def skeleton() -> Skeleton:
    """Return the skeleton; the y axis of each joint runs along its bone, seen from the side."""
    rows = list(_TRUNK)
    for name, parent, start, end in _PAIRS:
        for side, sign in (("left", 1.0), ("right", -1.0)):
            paired = parent if any(parent == row[0] for row in _TRUNK) else f"{parent}_{side}"
            mirrored = [(sign * p[0], p[1], p[2]) for p in (start, end)]
            rows.append((f"{name}_{side}", paired, *mirrored))
    names = tuple(row[0] for row in rows)
    parents = np.array([-1 if row[1] is None else names.index(row[1]) for row in rows], dtype=np.int32)
    position = np.array([row[2] for row in rows], float)
    along = np.array([row[3] for row in rows], float) - position
    angle = np.degrees(np.arctan2(along[:, 2], along[:, 1]))
    has_parent = parents >= 0
    parent_angle = np.where(has_parent, angle[parents], 0.0)
    offset = position - np.where(has_parent[:, None], position[parents], 0.0)
    to_parent = rotation_matrix(quaternion((1, 0, 0), -parent_angle))
    translation = np.einsum("jik,jk->ji", to_parent, offset)
    rotation = quaternion((1, 0, 0), angle - parent_angle)
    return Skeleton(names, parents, JointPoses(translation[None].astype(np.float32), rotation[None].astype(np.float32)))


def gallop(bones: Skeleton, frame_count: int, generator: np.random.Generator) -> JointPoses:
    """Return the poses of a loop of `STRIDES` strides over `frame_count` frames; the last frame runs on to the first.

    The generator draws how much the second stride differs from the first, and how the tail swings.
    """
    loop = np.arange(frame_count) / frame_count
    stride = loop * STRIDES
    # Longer and shorter strides take turns, by up to 6 percent.
    reach = 1.0 + generator.uniform(0.03, 0.06) * np.sin(2.0 * np.pi * loop)
    turn = {name: np.zeros(frame_count) for name in bones.names}
    for leg, touch_down in _TOUCH_DOWN.items():
        kind, side = leg.split("_")
        for bone, keys in (_FORE_KEYS if kind == "fore" else _HIND_KEYS).items():
            curve = CubicSpline((*_KEY_PHASES, 1.0), (*keys, keys[0]), bc_type="periodic")
            turn[f"{bone}_{side}"] = -reach * curve((stride - touch_down) % 1.0)
    _turn_trunk(turn, stride, reach)
    wag = _turn_tail_and_ears(turn, stride, loop, generator)
    rest = bones.rest
    turns = quaternion((1, 0, 0), np.stack([turn[name] for name in bones.names], axis=1))
    rotations = multiply_quaternions(np.repeat(rest.rotations.astype(float), frame_count, axis=0), turns)
    for name, degrees in wag.items():
        joint = bones.names.index(name)
        rotations[:, joint] = multiply_quaternions(rotations[:, joint], quaternion((0, 0, 1), degrees))
    translations = np.repeat(rest.translations.astype(float), frame_count, axis=0)
    translations[:, 0, 2] += 0.03 * np.sin(2.0 * np.pi * (stride - 0.1))
    translations[:, 0, 1] += _ride_height(bones, JointPoses(translations, rotations), stride)
    return JointPoses(translations.astype(np.float32), rotations.astype(np.float32))


def _wave(stride: NDArray, peak: float) -> NDArray[np.float64]:
    return np.cos(2.0 * np.pi * (stride - peak))


def _turn_trunk(turn: dict[str, NDArray], stride: NDArray, reach: NDArray) -> None:
    """Round the spine while the legs gather, hollow it while they extend; rock the body and balance with the neck."""
    flex = reach * _wave(stride, 0.90)
    # The forehand is up while the hind legs carry, down while the fore legs do.
    rock = -5.0 * _wave(stride, 0.10)
    turn["pelvis"] = -11.0 * flex + rock
    turn["loin"] = 9.0 * flex
    turn["back"] = 7.0 * flex
    turn["chest"] = 2.0 * flex
    # A galloping horse carries its neck lower than a standing one: 12 and 6 degrees.
    turn["neck_low"] = 12.0 - 0.5 * rock + 7.0 * _wave(stride, 0.45)
    turn["neck_high"] = 6.0 + 5.0 * _wave(stride, 0.52)
    turn["head"] = -14.0 - 7.0 * _wave(stride, 0.58)


def _turn_tail_and_ears(
    turn: dict[str, NDArray], stride: NDArray, loop: NDArray, generator: np.random.Generator
) -> dict[str, NDArray]:
    """Lift the tail, let a wave run down it, lay the ears back; returns the sideways degrees of the tail joints."""
    # Lift of each tail joint in degrees, its swing, and the lag of the swing behind the pelvis in strides.
    for name, lift, swing, lag in (("tail_1", 22, 9, 0.1), ("tail_2", 14, 11, 0.22), ("tail_3", 6, 13, 0.34)):
        turn[name] = lift + swing * _wave(stride, lag)
    turn["tail_4"] = 4.0 + 16.0 * _wave(stride, 0.46)
    for side in ("left", "right"):
        turn[f"ear_{side}"] = -32.0 + 9.0 * _wave(stride, 0.7)
    shift, sway = generator.uniform(0.0, 1.0), generator.uniform(7.0, 11.0)
    return {f"tail_{k}": sway * np.sin(2.0 * np.pi * (loop - shift - 0.08 * k)) for k in (1, 2, 3, 4)}


def _ride_height(bones: Skeleton, poses: JointPoses, stride: NDArray) -> NDArray[np.float64]:
    """Return the lift of the body, in metres, that sets the hooves in stance on the ground, smooth over the stride."""
    world, bind = bones.world(poses), bones.bind()
    design, wanted = [], []
    harmonics = [np.ones_like(stride)]
    for order in (1, 2):
        harmonics += [np.cos(2.0 * np.pi * order * stride), np.sin(2.0 * np.pi * order * stride)]
    for leg, touch_down in _TOUCH_DOWN.items():
        kind, side = leg.split("_")
        joint = bones.names.index(f"{kind}_pastern_{side}")
        row = next(row for row in _PAIRS if row[0] == f"{kind}_pastern")
        x, z = (row[3][0] if side == "left" else -row[3][0]), row[3][2]
        motion = world[:, joint] @ np.linalg.inv(bind[joint])
        sole = [(motion @ np.array([x, 0.0, z + at, 1.0]))[:, 1] for at in _SOLE]
        phase = ((stride - touch_down) % 1.0) / _STANCE
        # Weight of the contact: the middle of the stance counts, its ends fade out.
        weight = np.where(phase < 1.0, np.sin(np.pi * np.minimum(phase, 1.0)), 0.0)
        design.append(weight[:, None] * np.stack(harmonics, axis=1))
        wanted.append(-weight * np.minimum(*sole))
    fit = np.linalg.lstsq(np.concatenate(design), np.concatenate(wanted), rcond=None)[0]
    # In the suspension no hoof says how high the body is: it flies 5 cm higher.
    suspension = np.exp(-(((((stride - 0.88) + 0.5) % 1.0 - 0.5) / 0.09) ** 2))
    return np.stack(harmonics, axis=1) @ fit + 0.05 * suspension
