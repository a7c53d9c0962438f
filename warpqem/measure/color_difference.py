"""How different two colours look: CIEDE2000 between linear Rec. 709 colours, as USD's displayColor holds them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["ciede2000", "color_difference", "linear_to_lab"]

Floats = npt.NDArray[np.float64]

# Linear Rec. 709 (the primaries of sRGB) to CIE XYZ, IEC 61966-2-1.
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
# White of that matrix, D65.
WHITE = TO_XYZ.sum(axis=1)
# CIE 15: below this ratio to white a line replaces the cube root; it has a slope at black.
LINEAR_BELOW = (6 / 29) ** 3


def linear_to_lab(color: Floats) -> Floats:
    """CIELAB (S, 3), white D65, of linear Rec. 709 colours (S, 3)."""
    ratio = np.einsum("ij,sj->si", TO_XYZ, color) / WHITE
    f = np.where(ratio > LINEAR_BELOW, np.cbrt(np.maximum(ratio, 0)), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    x, y, z = f.T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)


def color_difference(first: Floats, second: Floats) -> Floats:
    """CIEDE2000 difference (S,) of linear Rec. 709 colours (S, 3); 1 is about what an eye can just see."""
    return ciede2000(linear_to_lab(first), linear_to_lab(second))


def ciede2000(first: Floats, second: Floats) -> Floats:
    """CIEDE2000 difference (S,) of CIELAB colours (S, 3), all parametric factors 1.

    Sharma, Wu and Dalal, "The CIEDE2000 Color-Difference Formula: Implementation Notes, Supplementary Test Data, and
    Mathematical Observations" (2005), equations 2 to 22.
    """
    (l1, a1, b1), (l2, a2, b2) = first.T, second.T
    chroma_mean = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2
    g = 0.5 * (1 - np.sqrt(chroma_mean**7 / (chroma_mean**7 + 25.0**7)))
    a1, a2 = (1 + g) * a1, (1 + g) * a2
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, a)) % 360 for a, b in ((a1, b1), (a2, b2)))

    grey = c1 * c2 == 0
    hue_step = np.where(grey, 0.0, (h2 - h1 + 180) % 360 - 180)
    lightness, chroma = l2 - l1, c2 - c1
    hue = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(hue_step) / 2)

    # Hues half a circle apart have their mean on the side that equation 14 says.
    wide = np.abs(h1 - h2) > 180
    around = np.where(h1 + h2 < 360, 360.0, -360.0)
    hue_mean = np.where(grey, h1 + h2, (h1 + h2 + wide * around) / 2)
    l_mean, c_mean = (l1 + l2) / 2, (c1 + c2) / 2

    t = (
        1
        - 0.17 * np.cos(np.radians(hue_mean - 30))
        + 0.24 * np.cos(np.radians(2 * hue_mean))
        + 0.32 * np.cos(np.radians(3 * hue_mean + 6))
        - 0.20 * np.cos(np.radians(4 * hue_mean - 63))
    )
    s_l = 1 + 0.015 * (l_mean - 50) ** 2 / np.sqrt(20 + (l_mean - 50) ** 2)
    s_c = 1 + 0.045 * c_mean
    s_h = 1 + 0.015 * c_mean * t
    rotation = 30 * np.exp(-(((hue_mean - 275) / 25) ** 2))
    r_c = 2 * np.sqrt(c_mean**7 / (c_mean**7 + 25.0**7))
    r_t = -np.sin(np.radians(2 * rotation)) * r_c
    terms = lightness / s_l, chroma / s_c, hue / s_h
    squared = terms[0] ** 2 + terms[1] ** 2 + terms[2] ** 2 + r_t * terms[1] * terms[2]
    difference: Floats = np.sqrt(np.maximum(squared, 0.0))
    return difference
