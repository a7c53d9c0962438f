"""Weights of morph targets, as equation 8 and table 1 of surface simplification guided by morph-targets print them."""

import numpy as np


def distance_sums(neutral, targets):
    """``DS = sum D``: for every vertex, its distances between the neutral shape and each target, added up."""
    sums = []
    for vertex in range(len(neutral)):
        sums.append(sum(np.linalg.norm(np.float64(target[vertex]) - np.float64(neutral[vertex])) for target in targets))
    return np.array(sums)


def thirds(neutral, targets):
    """0.33, 0.66 or 1 by the place of each vertex among all, sorted by ``DS``, counted from one."""
    sums = distance_sums(neutral, targets)
    count, weights = len(sums), {}
    for index, vertex in enumerate(sorted(range(count), key=lambda v: sums[v]), start=1):
        weights[vertex] = 0.33 if index <= count / 3 else 1.0 if index >= 2 * count / 3 else 0.66
    return np.array([weights[vertex] for vertex in range(count)])
