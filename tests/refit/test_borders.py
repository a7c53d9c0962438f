"""Borders of the input and of the output, as a refit finds them."""

import numpy as np
import pytest

import warpqem
from tests.support import meshes
from tests.support.moving_meshes import MESHES
from warpqem.refit import fit_surface


def alone_in(faces) -> np.ndarray:
    """The half-edges (3N,) that no other one runs against."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    there = set(map(tuple, ends.tolist()))
    return np.array([h for h, (a, b) in enumerate(ends.tolist()) if (b, a) not in there], dtype=np.int32)


def with_holes():
    points, faces = meshes.waving_grid(16, 3)
    return points, np.delete(faces, [40, 41, 200, 201, 202, 300], axis=0)


def with_a_sheet_at_an_edge():
    """A grid, and a strip that stands on one of its rows: edges of three faces."""
    points, faces = meshes.waving_grid(12, 3)
    row = np.arange(13) + 6 * 13
    top = points[:, row] + np.array([0.0, 0.0, 0.3], dtype=np.float32)
    new = points.shape[1] + np.arange(13)
    strip = [(row[i], row[i + 1], new[i + 1]) for i in range(12)] + [(row[i], new[i + 1], new[i]) for i in range(12)]
    return np.concatenate([points, top], axis=1), np.concatenate([faces, strip]).astype(np.int32)


def in_pieces():
    """A ball, and small sheets of which some are pruned."""
    points, faces = meshes.icosphere(3)
    sheet, sheet_faces = meshes.grid(3, 3)
    sheets = [0.1 * sheet + [2.0 + k, 0, 0] for k in range(4)]
    parts = [faces, *(sheet_faces + len(points) + k * len(sheet) for k in range(4))]
    return np.concatenate([points, *sheets])[None].astype(np.float32), np.concatenate(parts).astype(np.int32)


CASES = {**MESHES, "holes": with_holes(), "sheet": with_a_sheet_at_an_edge(), "pieces": in_pieces()}


@pytest.mark.parametrize("ratio", [0.5, 0.15])
@pytest.mark.parametrize("name", list(CASES))
def test_borders_are_all_half_edges_without_an_opposite_one(name, ratio, device, monkeypatch):
    points, faces = CASES[name]
    found, find = [], fit_surface.find_borders

    def noted(half_edge, is_left, out_faces, is_open):
        found.append((is_left, out_faces, find(half_edge, is_left, out_faces, is_open)))
        return found[-1][2]

    monkeypatch.setattr(fit_surface, "find_borders", noted)
    result = warpqem.simplify(points, faces, ratio=ratio, quality="best", measure=False, device=device)
    assert found
    for is_left, out_faces, (of_input, of_output) in found:
        mended = faces if result.repair is None else result.repair.faces
        np.testing.assert_array_equal(of_input, alone_in(mended[is_left]))
        np.testing.assert_array_equal(of_output, alone_in(out_faces))
        assert of_input.dtype == of_output.dtype == np.int32
