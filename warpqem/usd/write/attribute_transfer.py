"""Where on the input mesh each element of the simplified mesh gets its values from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from warpqem.attribute_fit.input_samples import InputSamples, find_input_samples
from warpqem.attribute_fit.partners import Partners, PartnerSearch
from warpqem.attribute_fit.values import ValueLayout
from warpqem.mesh.blending import blend
from warpqem.mesh.mesh_input import is_proper
from warpqem.pipeline.surface_transfer import SurfaceTransfer, surface_transfer
from warpqem.runtime.device import resolve_device
from warpqem.usd.read.mesh_seams import MeshSeams
from warpqem.usd.read.read_mesh import MeshSource
from warpqem.usd.write.feature_subsets import FAMILY
from warpqem.usd.write.smooth_normals import has_normals, is_smooth_scheme
from warpqem.usd.write.spread import spread
from warpqem.usd.write.vertex_colors import fitted_values

if TYPE_CHECKING:
    from warpqem.pipeline.result import SimplifiedMesh

__all__ = ["AttributeTransfer", "Rows"]

# Shorter vectors than this have no direction.
SHORTEST = 1e-12
# Frames that values are fitted in at most: with eight the texture of a cape was off by 29 % less than by values of one
# point, with two by 6 %, with one by 3 %.
MAX_FRAMES = 8
NO_SEAMS = np.zeros((0, 2), dtype=np.int32)


@dataclass(frozen=True)
class Rows:
    """Output elements as blends of input elements.

    Attributes:
        index: int64, shape (R, K), input elements.
        weight: float32, shape (R, K), not negative, each row sums to one.
    """

    index: npt.NDArray[np.int64]
    weight: npt.NDArray[np.float32]

    @property
    def heaviest(self) -> npt.NDArray[np.int64]:
        """The input element with the largest weight of each row, shape (R,)."""
        return np.take_along_axis(self.index, self.weight.argmax(axis=1)[:, None], axis=1)[:, 0]

    def pick(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """The value of the heaviest input element: (R, ...) of (elements, ...)."""
        return values[self.heaviest]

    def blend(self, values: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """The weighted mean: (R, ...) float64 of (elements, ...)."""
        return blend(values[self.index], self.weight)

    def blend_directions(self, values: npt.NDArray[Any], signed: bool = True) -> npt.NDArray[np.float64]:
        """The weighted mean of vectors (elements, ..., D), scaled to length one; where it is zero, the heaviest.

        Args:
            values: Directions.
            signed: False if a vector and its negative mean the same, as with the quaternions of rotations. These keep
                the mean of their lengths.
        """
        corners, heaviest = values[self.index].astype(np.float64), self.pick(values).astype(np.float64)
        weight = self.weight.astype(np.float64).reshape(*self.weight.shape, *[1] * (corners.ndim - 2))
        # What is not finite stays so.
        with np.errstate(invalid="ignore"):
            if not signed:
                agreement = (corners * heaviest[:, None]).sum(axis=-1, keepdims=True)
                corners = np.where(agreement < 0, -corners, corners)
            mean = (weight * corners).sum(axis=1)
            length = np.linalg.norm(mean, axis=-1, keepdims=True)
            # A quaternion of another length than one stays so: what its maker means by it is not known.
            wanted = 1.0 if signed else (weight * np.linalg.norm(corners, axis=-1, keepdims=True)).sum(axis=1)
            return np.where(length > SHORTEST, wanted * mean / np.maximum(length, SHORTEST), heaviest)


class AttributeTransfer:
    """Rows for the points, faces and corners of one simplified mesh.

    Attributes:
        feature_points: Points of it that are feature points of a face, by name.
        normals: How normals come to it: fitted to the input's, blended from the nearest ones, or not at all.
        shades_all: Whether a mesh without normals gets some, too.
        only_nearer: Whether it gets none if its own faces' shading is nearer to the input's than those would be.
        read_pose: The vertices of the input, float32, shape (V, 3), in each frame that is written, in its space.
        frames: The frames that are written, if there are several; set before values are transferred.
        read_placed: Its points in each of these.
        shown_codes: Time codes of the poses that a skin, which is written at rest, is shown in.
        read_shown: The vertices of the input, likewise, in each of these.
        reference: float32, shape (V', 3), its points in the pose of `reference_points`.
    """

    def __init__(
        self,
        source: MeshSource,
        faces: npt.NDArray[np.int32],
        reference_points: npt.NDArray[np.float32],
        result: SimplifiedMesh,
        seams: MeshSeams,
        device: str | None = None,
        surfaces: dict[bytes, SurfaceTransfer] | None = None,
    ) -> None:
        """Prepare for one mesh.

        Args:
            source: The input mesh.
            faces: int32, shape (N, 3), its triangles as given to `warpqem.simplify`.
            reference_points: float32, shape (V, 3), the pose of `result.points[0]` on the input.
            result: What that returned.
            seams: The seams of the input.
            device: Warp device; None for the default.
            surfaces: What is found for each set of seams, and kept for others of the same result; None for none.
        """
        self.prim = source.prim
        self.input_count = source.element_count
        self.topology = source.topology
        self.point_count = source.point_count
        self.seams = seams
        self.faces = result.faces
        self.vertex_count: int = result.points.shape[1]
        self.face_polygon = source.topology.triangle_polygons[result.face_map].astype(np.int64)
        self._input = (reference_points, faces, result)
        self.feature_points: dict[str, int] = {}
        self.reference: npt.NDArray[np.float32] = result.points[0]
        self.shades_all = False
        self.frames: range = range(0)
        # Nothing here may hold this object itself: it would keep the stages open until they are collected.
        self.read_placed: Callable[[int], npt.NDArray[np.float32]] = lambda _: result.points[0]
        self.only_nearer = False
        self.read_pose: Callable[[int], npt.NDArray[np.float32]] = lambda _: reference_points
        self.shown_codes: list[Usd.TimeCode] = []
        self.read_shown: Callable[[int], npt.NDArray[np.float32]] = lambda _: reference_points
        self.normals: Literal["fit", "keep", "none"] = "fit"
        self._device = device
        self._transfers = {} if surfaces is None else surfaces
        self._partners: dict[bytes, Partners] = {}

    def hard_edges(self) -> npt.NDArray[np.int32]:
        """Pairs (S, 2) of new points between which the input has `MeshSeams.hard`."""
        pairs: npt.NDArray[np.int32] = self._input[2].vertex_map[self.seams.hard]
        return pairs[(pairs[:, 0] != pairs[:, 1]) & (pairs >= 0).all(axis=1)]

    @property
    def is_plain(self) -> bool:
        """True for polygons without normals, which nothing says how to shade; else subdivision or normals do."""
        return not has_normals(self.prim) and not is_smooth_scheme(UsdGeom.Mesh(self.prim))

    def names_feature_point(self, subset: UsdGeom.Subset) -> bool:
        """True of a point subset that names one of `feature_points`."""
        family = subset.GetFamilyNameAttr().Get()
        return family == FAMILY and subset.GetPrim().GetName() in self.feature_points

    def vertices(self) -> Rows:
        """Output vertices as blends of authored points."""
        transfer = self._transfer(NO_SEAMS)
        wedge = transfer.vertex_wedge
        return Rows(self.topology.triangles[transfer.wedge_face[wedge]].astype(np.int64), transfer.wedge_weight[wedge])

    def colors(self, values: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """Colours of the output vertices, (V', ...) float64, from those of the authored points, (P, ...)."""
        points, faces, result = self._input
        blended = self.vertices().blend(values)
        if not np.isfinite(values).all():
            # Nothing lies between what is infinite, or no number, and the rest.
            return blended
        cluster = np.where(is_proper(faces)[:, None], result.vertex_map[faces], -1)
        corners = values[self.topology.triangles].reshape(len(faces), 3, -1)
        fitted, found = fitted_values(corners, points, faces, cluster, result.points[0])
        return np.where(found.reshape(-1, *[1] * (values.ndim - 1)), fitted.reshape(blended.shape), blended)

    def polygons(self) -> Rows:
        """Output faces as authored faces."""
        return Rows(self.face_polygon[:, None], np.ones((len(self.face_polygon), 1), dtype=np.float32))

    def facets(self, name: str) -> npt.NDArray[np.int8] | None:
        """`facet_signs` of the faces that the output faces go on from; None if normals shade none of them flat."""
        signs = self.seams.facets.get(name)
        return None if signs is None else signs[self._input[2].face_map]

    def is_cut(self, name: str) -> bool:
        """True if an attribute has seams, values of its own at corners of flat faces, or others on a sheet's back."""
        return len(self.seams.by_name.get(name, ())) > 0 or name in self.seams.facets or name in self.seams.two_sided

    def corners(self, name: str, of_points: bool = False) -> tuple[Rows, npt.NDArray[np.int32]]:
        """Output corners as blends of input corners, those of an attribute on one side of its own seams as one.

        Args:
            name: The attribute.
            of_points: True if it has a value for each point, of which welding made one vertex of several.

        Returns:
            Rows of corners, or of points, each used by at least one output corner, and the row of each output corner
            (int32, shape (N', 3)).
        """
        transfer = self._transfer(self.seams.by_name[name])
        used, row = np.unique(transfer.corner_wedge, return_inverse=True)
        elements = self.topology.triangles if of_points else self.topology.triangle_corners
        index = elements[transfer.wedge_face[used]].astype(np.int64)
        return Rows(index, transfer.wedge_weight[used]), row.reshape(-1, 3).astype(np.int32)

    def layout(
        self, name: str, of_points: bool, corner_row: npt.NDArray[np.int32] | None, over_frames: bool = False
    ) -> ValueLayout:
        """Where the values of an attribute stand, for `warpqem.attribute_fit`.

        Args:
            name: The attribute.
            of_points: True if it has a value for each authored point, else for each corner of the authored faces.
            corner_row: What `corners` gives; None for a value for each output vertex.
            over_frames: True for partners in several of `frames`, False for those in the reference pose.
        """
        # Nothing is cut along seams that are too many; all else goes by one search.
        seams = self.seams.by_name[name] if name in self.seams.dense else self._held_seams
        elements = self.topology.triangles if of_points else self.topology.triangle_corners
        found = self._partners_over_frames(seams) if over_frames else self._reference_partners(seams)
        return ValueLayout(found, elements, self.faces if corner_row is None else corner_row)

    def input_samples(
        self, pose: npt.NDArray[np.float32] | None = None, placed: npt.NDArray[np.float32] | None = None
    ) -> InputSamples | None:
        """Samples of the input in a pose of both, see `find_input_samples`; None for the reference pose."""
        points = self._input[0] if pose is None else pose
        faces = np.where(self.turned_faces[:, None], self.input_faces[:, ::-1], self.input_faces)
        found = find_input_samples(
            points, faces, self.reference if placed is None else placed, self.faces, resolve_device(self._device)
        )
        if found is None or not self.turned_faces.any():
            return found
        turned = self.turned_faces[found.face][:, None]
        return replace(found, weight=np.where(turned, found.weight[:, ::-1], found.weight))

    @cached_property
    def _held_seams(self) -> npt.NDArray[np.int32]:
        """The seams of all attributes, borders of subsets and creases: samples stay on their side of every one."""
        return self.seams.hold().astype(np.int32)

    @property
    def input_faces(self) -> npt.NDArray[np.int32]:
        """The triangles of the input on its vertices, int32, shape (N, 3)."""
        return self._input[1]

    @property
    def turned_faces(self) -> npt.NDArray[np.bool_]:
        """Those of them that the output goes on from the other way round, as mending does: bool, shape (N,)."""
        _, faces, result = self._input
        turned = np.zeros(len(faces), dtype=bool) if result.repair is None else result.repair.is_turned
        return np.asarray(turned, dtype=bool)

    @property
    def source_faces(self) -> npt.NDArray[np.int32]:
        """Those that the output's faces go on from, int32, shape (N',)."""
        found: npt.NDArray[np.int32] = self._input[2].face_map
        return found

    @property
    def has_backs(self) -> bool:
        """True where faces of the input lie back to back, so that its vertices face both ways."""
        repair = self._input[2].repair
        return repair is not None and bool(repair.is_double.any())

    def sides(self, seams: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
        """Which corners of the output are on one side of seams (S, 2) of the input: int32, shape (N', 3), by number."""
        return self._transfer(seams).corner_wedge

    def partner_search(self, seams: npt.NDArray[np.int32]) -> PartnerSearch:
        """What finds partners of samples on one side of seams, in poses of the input and of the output."""
        _, faces, result = self._input
        device, transfer = resolve_device(self._device), self._transfer(seams)
        return PartnerSearch(faces, result, transfer, seams.astype(np.int64), device)

    def _reference_partners(self, seams: npt.NDArray[np.int32]) -> Partners:
        key = seams.tobytes()
        if key not in self._partners:
            self._partners[key] = self.partner_search(seams).find(self._input[0], self.reference)
        return self._partners[key]

    def _partners_over_frames(self, seams: npt.NDArray[np.int32]) -> Partners:
        """Partners in some of the frames that are written: a sample meets other points where the surface slides."""
        if len(self.frames) < 2:
            return self._reference_partners(seams)
        key = b"frames" + seams.tobytes()
        if key not in self._partners:
            near, search = self._reference_partners(seams), self.partner_search(seams)
            chosen = spread(self.frames, MAX_FRAMES)
            found = [search.find(self.read_pose(frame), self.read_placed(frame), near) for frame in chosen]
            self._partners[key] = Partners.over_poses(found)
        return self._partners[key]

    def _transfer(self, seams: npt.NDArray[np.int32]) -> SurfaceTransfer:
        """Each attribute is cut along its own seams only: those of others would make seams where it has none."""
        key = seams.tobytes()
        if key not in self._transfers:
            points, faces, result = self._input
            self._transfers[key] = surface_transfer(points, faces, result, seams=seams, device=self._device)
        return self._transfers[key]
