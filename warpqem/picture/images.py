"""Compare what meshes look like: pictures of both from the same views, by the project's own ray caster."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from warpqem.arguments.array_input import finite_array
from warpqem.arguments.array_record import ArrayRecord
from warpqem.arguments.json_types import Json
from warpqem.arguments.number_input import check_function, whole_number
from warpqem.errors import DegenerateMeshError, MeshShapeError
from warpqem.measure.image_similarity import OverlapSums, Similarity, SimilaritySums
from warpqem.mesh.mesh_input import finite_points, read_faces, read_points
from warpqem.picture.layers import Layers, empty_layers, render_layers
from warpqem.picture.look import Look, corner_normals, smoothing_groups
from warpqem.picture.render import MARGIN, PlacedScene, View, check_up, place_scene
from warpqem.runtime.device import on_device

__all__ = ["IMAGE_FRAMES", "IMAGE_SIZE", "IMAGE_VIEWS", "ImagePair", "ImageScore", "PosedMesh", "compare_images"]

# Frames that files are drawn in, evenly spread: the first, the middle and the last one.
IMAGE_FRAMES = 3
# Azimuth and elevation in degrees: a quarter turn between views, all from a little above.
IMAGE_VIEWS = ((30.0, 12.0), (120.0, 12.0), (210.0, 12.0), (300.0, 12.0))
# Pixels along either side of a picture.
IMAGE_SIZE = 256


@dataclass(frozen=True, eq=False, repr=False)
class PosedMesh(ArrayRecord):
    """A mesh in one frame.

    Attributes:
        points: (V, 3).
        faces: (N, 3) integers, counter-clockwise seen from the front.
        normals: (N, 3, 3) shading normals at the corners, 0 for those of the face itself; None for smooth ones by the
            surface, with edges of more than 60 degrees.
        look: colours and textures; None for a plain surface.
    """

    points: npt.NDArray[np.floating]
    faces: npt.NDArray[np.integer]
    normals: npt.NDArray[np.floating] | None = None
    look: Look | None = None


@dataclass(frozen=True)
class ImageScore:
    """How alike pictures of two meshes are.

    Attributes:
        gray: of surfaces of one colour, by their shading normals; None where nothing was seen.
        shading: of the same pictures, but of the pixels alone that both cover wholly: what outlines differ by, which
            `silhouette` says, is left out. None where there is none.
        textured: of surfaces with their colours and textures; None where neither has any, or nothing was seen.
        silhouette: intersection over union of what both cover, 0 to 1; None where nothing was seen.
        frame_count: frames that were drawn.
        view_count: views of each.
        size: pixels along either side of a picture.
    """

    gray: Similarity | None
    shading: Similarity | None
    textured: Similarity | None
    silhouette: float | None
    frame_count: int
    view_count: int
    size: int

    def to_dict(self) -> dict[str, Json]:
        """Plain dictionaries, numbers and None, ready for JSON."""
        return asdict(self)


@dataclass(frozen=True, eq=False, repr=False)
class ImagePair(ArrayRecord):
    """Pictures of both meshes from one view.

    Attributes:
        frame: index.
        view: where they look from.
        reference: of the reference.
        test: of the other mesh.
    """

    frame: int
    view: View
    reference: Layers
    test: Layers


@on_device
def compare_images(
    reference: Sequence[PosedMesh],
    test: Sequence[PosedMesh],
    *,
    up: str = "y",
    size: int = IMAGE_SIZE,
    device: str | None = None,
    drawn: Callable[[ImagePair], None] | None = None,
) -> ImageScore:
    """Draw two meshes from the same four views in each frame, and compare the pictures.

    Rays are parallel. The middle of each frame's pictures is that of the reference's bounding box, and one scale, at
    which the reference fits into every picture, goes for all. Only pixels that either silhouette touches count.

    Args:
        reference: what it is to look like, frame by frame; a mesh without faces shows nothing.
        test: likewise, with as many frames.
        up: "y" or "z", the up axis.
        size: pixels along either side of a picture, at least 1.
        device: Warp device; None takes cuda:0 if present, else cpu.
        drawn: called with each pair of pictures.

    Raises:
        MeshShapeError: other numbers of frames, or arrays of other shapes.
        NonFinitePointError, FaceIndexError, DegenerateMeshError, OptionError, DeviceError: see :mod:`warpqem.errors`.
    """
    check_up(up)
    check_function(drawn, "drawn")
    size = whole_number(size, "size", expected="at least one pixel")
    if len(reference) != len(test) or not len(reference):
        raise MeshShapeError(f"frames: {len(reference)} of the reference and {len(test)} of the test, one or more")
    pairs = [(_checked(a, f"reference frame {i}"), _checked(b, f"test frame {i}")) for i, (a, b) in enumerate(
        zip(reference, test, strict=True))]  # fmt: skip
    views = _views([a if len(a.faces) else b for a, b in pairs], up)
    gray, shading, textured, overlap = SimilaritySums(), SimilaritySums(), SimilaritySums(), OverlapSums()
    for frame, (meshes, around) in enumerate(zip(pairs, views, strict=True)):
        scenes = [_scene(mesh, around[0], size, device) for mesh in meshes]
        for view in around:
            first, second = (
                empty_layers((size, size)) if scene is None else render_layers(scene.seen_from(view))
                for scene in scenes
            )
            counted = (first.covered > 0) | (second.covered > 0)
            gray.add(first.gray, second.gray, counted)
            shading.add(first.gray, second.gray, (first.covered == 1) & (second.covered == 1))
            textured.add(first.textured, second.textured, counted)
            overlap.add(first.covered, second.covered)
            if drawn is not None:
                drawn(ImagePair(frame, view, first, second))
    plain = all(mesh.look is None or mesh.look.is_plain for meshes in pairs for mesh in meshes)
    colored = None if plain else textured.result()
    return ImageScore(gray.result(), shading.result(), colored, overlap.result(), len(pairs), len(IMAGE_VIEWS), size)


def _checked(mesh: PosedMesh, name: str) -> PosedMesh:
    """A mesh with its points and faces as arrays; without those the mesh is one of nothing."""
    faces = np.asarray(mesh.faces)
    if not faces.size:
        return PosedMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))
    points = finite_points(read_points(mesh.points, f"{name}: points"), f"{name}: point of")
    if len(points) != 1:
        raise MeshShapeError(f"{name}: points: expected those of one frame, got {len(points)} frames")
    faces = read_faces(faces, f"{name}: faces", points.shape[1])
    shape = (len(faces), 3, 3)
    normals = None if mesh.normals is None else finite_array(mesh.normals, f"{name}: normals", shape)
    return PosedMesh(points[0], faces, normals, mesh.look)


def _views(meshes: Sequence[PosedMesh], up: str) -> list[list[View]]:
    """The views of each frame, about the middle of its mesh, all of the height that the largest of them needs."""
    boxes = []
    for mesh in meshes:
        used = mesh.points[np.unique(mesh.faces)].astype(np.float64) if len(mesh.faces) else np.zeros((1, 3))
        boxes.append((used, (used.min(axis=0) + used.max(axis=0)) / 2))
    height = 0.0
    for azimuth, elevation in IMAGE_VIEWS:
        across = View(azimuth, elevation, (0.0, 0.0, 0.0), 1.0, up).axes()[:2]
        height = max(height, *(2 * float(np.abs((used - middle) @ across.T).max()) for used, middle in boxes))
    if not height > 0.0:
        raise DegenerateMeshError("reference points: no extent in any frame")
    height *= 1.0 + MARGIN
    return [[View(a, e, (float(m[0]), float(m[1]), float(m[2])), height, up) for a, e in IMAGE_VIEWS] for _, m in boxes]


def _scene(mesh: PosedMesh, view: View, size: int, device: str | None) -> PlacedScene | None:
    """A mesh before the camera; None for one of nothing."""
    if not len(mesh.faces):
        return None
    normals = mesh.normals
    if normals is None:
        normals = corner_normals(mesh.points, mesh.faces, smoothing_groups(mesh.points, mesh.faces))
    return place_scene(mesh.points, mesh.faces, view, (size, size), look=mesh.look, normals=normals, device=device)
