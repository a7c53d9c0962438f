"""Choose the frames that decide the order of collapses."""

from __future__ import annotations

import numpy as np

__all__ = ["choose_key_frames"]

# Poses are told apart by about so many vertices, spread over the index range: enough to see every limb of a character.
SAMPLED_VERTICES = 1024


def choose_key_frames(points: np.ndarray, count: int) -> np.ndarray:
    """Farthest-point choice in pose space, starting with the first frame.

    The distance of two frames is the RMS distance of corresponding vertices after their centroids are laid together,
    so that travelling through the scene is not taken for a change of pose.

    Args:
        points: (F, V, 3) float32.
        count: how many frames to choose, at least 1.

    Returns:
        (min(F, count),) int, ascending.
    """
    frame_count, vertex_count, _ = points.shape
    if count >= frame_count:
        return np.arange(frame_count)
    step = max(1, vertex_count // SAMPLED_VERTICES)
    sample = points[:, ::step]
    sample = sample - sample.mean(axis=1, keepdims=True)
    distance = np.full(frame_count, np.inf)
    chosen = [0]
    while len(chosen) < count:
        distance = np.minimum(distance, ((sample - sample[chosen[-1]]) ** 2).sum(axis=(1, 2)))
        chosen.append(int(distance.argmax()))
    # A repeated frame (a still animation) adds nothing.
    return np.unique(chosen)
