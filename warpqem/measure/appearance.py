"""How two meshes look different when textured, shaded and coloured, beyond their shape, over all frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from warpqem.arguments.array_input import real_array
from warpqem.arguments.json_types import Json
from warpqem.arguments.number_input import check_function, whole_number
from warpqem.measure.appearance_errors import SEAM_SAMPLES, FieldErrors, MovingPair, UvErrors, UvMeasure, angles
from warpqem.measure.checked_meshes import CheckedMesh, check_same_frame_count, chosen_frames
from warpqem.measure.collapsed import standing_frames
from warpqem.measure.color_difference import color_difference
from warpqem.measure.followed_points import MovingMesh
from warpqem.measure.sampling import draw_material_samples
from warpqem.measure.surface_values import CornerValues, SurfaceValues, shared_names, shared_normals
from warpqem.mesh.mesh_input import finite_points, read_faces, read_points
from warpqem.runtime.device import on_device, resolve_device

__all__ = [
    "Appearance",
    "CornerValues",
    "SampledErrors",
    "SurfaceValues",
    "UvErrors",
    "compare_appearance",
]

Floats = npt.NDArray[np.float64]

# Samples on each mesh: errors of a smooth field to about 2 %. Samples times frames are no more than the second number,
# so that half as many are left on the longest clips.
SAMPLES = 4000
SAMPLE_FRAMES = 1_000_000

# Frames measured at most, evenly spread, the first and the last one included: a frame of a small mesh takes about 4 ms.
MAX_FRAMES = 500


@dataclass(frozen=True)
class SampledErrors:
    """Differences between samples of one mesh and the nearest points of the other, both ways.

    Attributes:
        mean: over samples and frames.
        p95: the 95th percentile over the samples, each with its mean over time.
        largest: at any sample in any frame.
    """

    mean: float
    p95: float
    largest: float


@dataclass(frozen=True)
class Appearance:
    """How a test mesh looks different from a reference.

    Attributes:
        uvs: errors of each set of texture coordinates that both meshes have.
        normals: angles between the shading normals, in degrees; None where one of the meshes has none.
        colors: CIEDE2000 differences of each set of colours that both meshes have, which are linear Rec. 709; 1 is
            about what an eye can just see.
        not_measured: why a measure has no value, by its name.
        sample_count: samples on each mesh.
        seam_sample_count: samples on the seams of each mesh.
        frame_count: frames measured: all, of more than 500 so many, evenly spread.
    """

    uvs: dict[str, UvErrors]
    normals: SampledErrors | None
    colors: dict[str, SampledErrors]
    not_measured: dict[str, str]
    sample_count: int
    seam_sample_count: int
    frame_count: int

    def to_dict(self) -> dict[str, Json]:
        """Plain dictionaries, numbers and None, ready for JSON."""
        return asdict(self)


@on_device
def compare_appearance(
    reference_points: npt.ArrayLike,
    reference_faces: npt.ArrayLike,
    reference_values: SurfaceValues,
    test_points: npt.ArrayLike,
    test_faces: npt.ArrayLike,
    test_values: SurfaceValues,
    *,
    samples: int | None = None,
    seed: int = 0,
    device: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Appearance:
    """Measure what a test mesh is textured, shaded and coloured by against a reference, in all frames.

    Of more than 500 frames so many count, evenly spread; frames in which either mesh is collapsed to a point or a line
    do not count. Samples are material points, spread evenly over the area of
    each mesh. What is compared lies at the nearest point of the other mesh that faces the same way, for texture
    coordinates on the same island; it is searched for in the first frame and followed from there.

    Args:
        reference_points: (F, V, 3) or (V, 3).
        reference_faces: (N, 3) integers.
        reference_values: values at the corners of these faces.
        test_points: (F, V', 3) or (V', 3), with as many frames.
        test_faces: (N', 3) integers.
        test_values: values at the corners of these faces.
        samples: samples on each mesh, at least 1; None for 4000, of more than 250 frames fewer, down to 2000.
        seed: seed of the samples, at least 0.
        device: Warp device name; None takes "cuda:0" where there is one, else "cpu".
        progress: called with the number of frames done and the number of frames.

    Raises:
        MeshShapeError, NonFinitePointError, FaceIndexError, DegenerateMeshError, OptionError, DeviceError: as
            :func:`warpqem.measure.compare`; the first one also where values do not have the shape of their faces.
    """
    seed = whole_number(seed, "seed", least=0)
    check_function(progress, "progress")
    reference = _sequence(reference_points, reference_faces, "reference")
    test = _sequence(test_points, test_faces, "test")
    check_same_frame_count(reference, test)
    standing = standing_frames(reference, test)
    reference, test = standing.reference, standing.test
    both = (reference_values.of_frames(standing.frames), test_values.of_frames(standing.frames))
    frames = chosen_frames(MAX_FRAMES, len(reference.points)).tolist()
    if samples is None:
        samples = min(SAMPLES, SAMPLE_FRAMES // len(frames))
    samples = whole_number(samples, "samples")
    reasons = dict[str, str]()
    uv_names = shared_names("texture coordinates", "uvs", *both, (both[0].uvs, both[1].uvs), reasons)
    normals = shared_normals(*both, reasons)
    color_names = shared_names("colours", "colors", *both, (both[0].colors, both[1].colors), reasons)
    uvs: dict[str, UvMeasure] = {}
    shading = None if normals is None else FieldErrors(normals, angles)
    colors = {n: FieldErrors((both[0].colors[n], both[1].colors[n]), color_difference) for n in color_names}
    if uv_names or shading or colors:
        pair = _make_pair(reference, test, samples, seed, resolve_device(device))
        uvs = {name: UvMeasure(pair, (both[0].uvs[name], both[1].uvs[name]), seed) for name in uv_names}
        fields = [*([] if shading is None else [shading]), *colors.values()]
        _measure_frames(pair, list(uvs.values()), fields, frames, progress)
    return Appearance(
        uvs={name: measure.errors(name, reasons) for name, measure in uvs.items()},
        normals=None if shading is None else SampledErrors(*shading.figures()),
        colors={name: SampledErrors(*errors.figures()) for name, errors in colors.items()},
        not_measured=reasons,
        sample_count=samples,
        seam_sample_count=SEAM_SAMPLES,
        frame_count=len(frames),
    )


def _measure_frames(
    pair: MovingPair,
    uvs: list[UvMeasure],
    fields: list[FieldErrors],
    frames: list[int],
    progress: Callable[[int, int], None] | None,
) -> None:
    """Take some frames from the first one on, which the pair shows."""
    ways = pair.correspond() if fields else ()
    for done, frame in enumerate(frames, start=1):
        if frame:
            pair.show(frame)
            for way in ways:
                way.follow()
        for errors in fields:
            assert ways
            errors.add(pair, ways, frame)
        for measure in uvs:
            measure.add(frame)
        if progress is not None:
            progress(done, len(frames))


def _sequence(points: npt.ArrayLike, faces: npt.ArrayLike, name: str) -> CheckedMesh:
    """A checked sequence that keeps the points as they are given, in single precision, too."""
    given = read_points(real_array(points, f"{name} points", ("F", "V", 3), ("V", 3)), f"{name} points")
    array: Any = finite_points(given, f"{name} points:")
    face_array = read_faces(faces, f"{name} faces", array.shape[1]).astype(np.int64)
    return CheckedMesh(array, face_array, np.unique(face_array))


def _make_pair(reference: CheckedMesh, test: CheckedMesh, samples: int, seed: int, device: str) -> MovingPair:
    centre, diagonal = _scale(reference)
    drawn = tuple(
        draw_material_samples(mesh, samples, seed + number, name)
        for number, (mesh, name) in enumerate(((reference, "reference"), (test, "test")))
    )
    return MovingPair(
        MovingMesh(reference, centre, diagonal, device),
        MovingMesh(test, centre, diagonal, device),
        (drawn[0], drawn[1]),
    )


def _scale(reference: CheckedMesh) -> tuple[Floats, Floats]:
    """Centres (F, 3) and diagonals (F,) of the bounding boxes of the vertices in use, frame by frame."""
    boxes = np.empty((len(reference.points), 2, 3))
    for box, points in zip(boxes, reference.points, strict=True):
        used = points[reference.used].astype(np.float64)
        box[0], box[1] = used.min(axis=0), used.max(axis=0)
    return boxes.mean(axis=1), np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1)
