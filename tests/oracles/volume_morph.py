"""Volume morph by radial basis functions (Noh & Neumann 2001), as one dense linear system."""

import numpy as np


class Multiquadrics:
    """``x -> sum_i w_i sqrt(r_i^2 + d^2) + B x + c`` through given points; the weights cancel linear functions."""

    def __init__(self, source, target, distance):
        self.source, self.distance = np.float64(source), distance
        count = len(source)
        linear = np.concatenate([np.ones((count, 1)), self.source], axis=1)
        system = np.block([[self.basis(self.source), linear], [linear.T, np.zeros((4, 4))]])
        self.weights = np.linalg.solve(system, np.concatenate([np.float64(target), np.zeros((4, 3))]))

    def basis(self, points):
        away = points[:, None] - self.source
        return np.sqrt((away**2).sum(axis=2) + self.distance**2)

    def __call__(self, points):
        linear = np.concatenate([np.ones((len(points), 1)), points], axis=1)
        return np.concatenate([self.basis(points), linear], axis=1) @ self.weights

    def derivative(self, points):
        """(V, 3, 3): how each coordinate (first index) grows along each axis (last)."""
        slope = (points[:, None] - self.source) / self.basis(points)[:, :, None]
        curved = np.einsum("vna,nk->vka", slope, self.weights[: len(self.source)])
        return curved + self.weights[-3:].T
