"""Refit: a last least-squares fit of the output to the input surface over the key frames.

Placement gives every vertex the optimum of its own quadric; what the faces between the vertices do is left to chance.
The refit moves all vertices together so that the two surfaces are nearest, both ways. Every vertex gets *one*
correction, constant over all frames in the material frame (:mod:`warpqem.kernels.material_frame`), so it adds hardly
any motion over the surface, works for unordered poses, and costs the same for any number of frames. Corrections free in
every frame were measured too: they gain 2 % more and slide.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import warp as wp

from warpqem.decimation.adjacency import build_adjacency
from warpqem.frames.device_frames import to_device
from warpqem.kernels import material_frame as frame_kernels
from warpqem.kernels import refit as kernels
from warpqem.kernels.surface_limits import raise_limits
from warpqem.mesh.grouping import different
from warpqem.mesh.mesh_input import AnimatedMesh
from warpqem.place.block_placer import PlacedFrames
from warpqem.place.frame_store import AnyFrameStore, DeviceFrameStore
from warpqem.place.place import Placer
from warpqem.refit.component_limits import ComponentLimits
from warpqem.refit.far_places import FarLook, FarPlaces
from warpqem.refit.fit_under_way import FitSteps, FitUnderWay
from warpqem.refit.holds import Holds
from warpqem.refit.matching import Matching, make_surface
from warpqem.refit.material_frames import MaterialFrames
from warpqem.refit.normal_equations import NormalEquations
from warpqem.refit.reference import Reference
from warpqem.refit.scales import FitSizes
from warpqem.refit.seam_edges import find_borders, find_seams
from warpqem.runtime import new_arrays
from warpqem.runtime.device import device_traits
from warpqem.runtime.launches import launch
from warpqem.runtime.readback import joined

__all__ = ["fit_corrections"]

# Pairs are found and the system is solved so often: the third round gains 0.5 % for a tenth of the job's time.
ROUNDS = 3
# For a rough fit: where such a surface is far from the input, that of three rounds is too.
ROUGH_ROUNDS = 2

# Each sample is paired in one key frame, and in one more for so many frames of the animation, so that the refit costs
# no more than the rest of the job. One frame for each sample gives away 0.5 % of the error, as samples take turns.
FRAMES_PER_TURN = 48

# Pairs further apart than so many times the largest error of a collapse are left out: there the search for the nearest
# point got lost. The surfaces themselves are nowhere further apart than about three times that.
REACH = 4.0

# Places that come further away are held so often, one that was far before with a ring of vertices more around it.
ATTEMPTS = 5
# Where more than this part of the vertices is at such places, the surfaces are paired anew before, so that others
# adapt to what is held. For fewer that would be one more round of the whole fit for a handful of vertices.
MANY_FAR = 0.02
# Then their whole component moves by these shares of what is left, and stays as placed in the end.
SHARES = (0.75, 0.67, 0.5, 0.5, 0.0)

# A pair that lies so many times further apart than what the mesh has come to counts half. Such pairs are where the
# search went to another side or the surface ends, and draw vertices along it: without this slide is 6 % more, edges 2 %
# and the largest distance 1 %, and the error no less. Twice as near, the error is 1 % more.
DOUBTED = 5.0
# At least so far apart, in diagonals: ten times what float32 resolves.
MIN_DOUBTED = 1e-6

# Where the host would wait to see whether vertices are held back, they are held so often before it looks: a time that
# changes nothing takes the device less than the host would wait. The gallop takes one to four.
HELD_AT_ONCE = 4
# A rough fit is only looked at: it may still turn a face over.
HELD_ROUGHLY = 4
# There so many attempts to hold far places are made before it looks, too.
ATTEMPTS_AHEAD = 2
# Where the host would wait, and frames come in so many blocks from the device itself, looking through them takes less.
FEW_BLOCKS = 2


def fit_corrections(
    mesh: AnimatedMesh,
    placer: Placer,
    placed: AnyFrameStore,
    key_frames: np.ndarray,
    error: float,
    recent_error: float,
    blocks: Sequence[slice],
    device: str,
    roughly: bool = False,
) -> FitUnderWay:
    """What moves placed frames, so that the surface as a whole is nearest to the input.

    Pinned vertices, corners of seams and those that stand for one input vertex stay where they are; others on seams
    move less along the surface. Borders are fitted to borders, seams to seams. A face that does not face away from the
    input in some frame does not after the refit. No component comes further from the input than it was, at samples of
    both surfaces and at vertices in the key frames; nor, by more than a little, from its own part of it.

    Args:
        mesh: the input.
        placer: what placed its output vertices.
        placed: all frames.
        key_frames: (K,) int, the frames to fit.
        error: the largest error of a collapse, in diagonals.
        recent_error: the root mean square of the errors of the last collapses, in diagonals.
        blocks: frames to look at at once, when all are looked through for faces that turn over.
        device: Warp device.
        roughly: with fewer rounds, and components may come further from the input than they were.
    """
    fit = _Refit(mesh, placer, placed, key_frames, max(DOUBTED * recent_error, MIN_DOUBTED), blocks, device)
    if fit.has_no_area:
        return FitUnderWay(lambda frames: frames)
    reach = REACH * error
    # The first pairs need the search. Distances decide only whether components come further away.
    fit.improve(reach, search=True, take_limits=not roughly)
    for left in reversed(range((ROUGH_ROUNDS if roughly else ROUNDS) - 1)):
        # So do the last ones: of twelve clips the error is 0.3 % more without, of assemblies 1 %.
        fit.improve(reach, search=left == 0 and not roughly)
    fit.hold_back(HELD_ROUGHLY if roughly else None)
    return FitUnderWay(fit.apply, None if roughly else fit.settle(reach))


class _Refit:
    """The corrections of one mesh, on the device."""

    def __init__(
        self,
        mesh: AnimatedMesh,
        placer: Placer,
        placed: AnyFrameStore,
        key_frames: np.ndarray,
        far: float,
        blocks: Sequence[slice],
        device: str,
    ) -> None:
        self._device, self._far = device, far
        self._faces = placer.faces
        self._vertex_count = placed.vertex_count
        self._corner_vertex = new_arrays.uploaded(placer.faces.ravel(), dtype=wp.int32, device=device)
        self._adjacency = build_adjacency(self._corner_vertex, self._vertex_count)
        rings = self._make_rings(placed.read(slice(0, 1)))
        self._all_frames = MaterialFrames(rings, placer.free, placed, blocks, device)
        is_near = self._all_frames.is_kept or (isinstance(placed, DeviceFrameStore) and len(blocks) <= FEW_BLOCKS)
        # Where frames come one block after another, looking through them takes longer than a wait.
        self._works_ahead = device_traits(device).own_memory and is_near
        keys = placed.chosen(key_frames)
        self._keys = self._all_frames.of(keys)
        self._equations = NormalEquations(self._corner_vertex, self._adjacency)
        turns = max(1, min(len(key_frames), mesh.frame_count // FRAMES_PER_TURN))
        # Of a pruned component nothing is near to the output.
        is_left = _is_left(placer.vertex_map, mesh.faces)
        faces, used = _left(mesh, is_left)
        seams = find_seams(placer.seam, mesh.faces, is_left, placer.vertex_map, self._faces, self._vertex_count)
        self._sizes = FitSizes.of(
            keys.points, placer.faces, self._corner_vertex, self._vertex_count, turns, len(seams[1].half_edge)
        )
        corner_vertex = new_arrays.uploaded(faces.ravel(), dtype=wp.int32, device=device)
        reference = Reference.of(mesh, key_frames, device)
        source = make_surface(
            reference.points,
            corner_vertex,
            build_adjacency(corner_vertex, mesh.vertex_count),
            seams[0].marks,
        )
        self._moved = new_arrays.clone(self._keys.points)
        self._matching = Matching(
            source,
            make_surface(self._moved, self._corner_vertex, self._adjacency, seams[1].marks),
            placer.vertex_map,
            faces,
            placer.faces,
            placer.nearest,
            turns,
            self._sizes.values,
            find_borders(placer.border, is_left, self._faces, placer.is_open),
            (seams[0].half_edge, seams[1].half_edge),
            device,
        )
        self._holds = Holds(placer.on_seam, device)
        self._correction = new_arrays.zeros(self._vertex_count, dtype=wp.vec3, device=device)
        self._far_places = FarPlaces(
            self._corner_vertex, self._vertex_count, int(MANY_FAR * self._vertex_count), device
        )
        self._limits = ComponentLimits(
            self._matching,
            source.points,
            self._keys.points,
            faces,
            used,
            placer.vertex_map,
            self._faces,
            reference.frame_scale,
            device,
        )

    @property
    def has_no_area(self) -> bool:
        """Whether the host knows that all faces are lines or points: such a surface says nothing of where to move."""
        return self._sizes.is_flat

    def _make_rings(self, first: PlacedFrames) -> frame_kernels.OneRings:
        rings = frame_kernels.OneRings()
        rings.corner_vertex = self._corner_vertex
        rings.adjacency_start, rings.adjacent_corner = self._adjacency.start, self._adjacency.corner
        rings.reference, rings.reference_normal = (
            to_device(values[0], self._device) for values in (first.points, first.normals)
        )
        return rings

    def improve(self, reach: float, search: bool = False, take_limits: bool = False) -> None:
        """One round: pair the surfaces as they lie now, and solve for the corrections.

        A surface without area, such as one that is flattened to a line, stays as it is: it has nothing to fit to.
        There the device solves nothing where the host does not know.

        Args:
            reach: points further apart are no pair.
            search: walks that end at no partner are followed by a search.
            take_limits: let the distances of each component come to what they are now; this needs the search.
        """
        self._keys.move(self._correction, self._moved)
        self._matching.find(reach, search, raise_limits if take_limits else None, self._limits.sampled)
        self._equations.assemble(self._matching, self._keys, self._sizes, self._correction, self._far)
        wp.copy(self._correction, self._equations.solve(self._holds, self._sizes.has_area))

    def hold_back(self, most: int | None = None) -> None:
        """Stiffen vertices that turn a face over in some frame, and at last do not move them.

        Likewise those that would go further than an edge is long in the mean: no pair is there, and few faces far off
        that reach beyond their pairs decide.

        The others are solved for anew each time: a vertex that stays where its neighbours do not expect it would cost
        more than its own share of the fit.

        Args:
            most: So often at most; None for as often as it takes. Where the host would wait to see, :meth:`settle`
                sees to that.
        """
        if self._works_ahead:
            for _ in range(HELD_AT_ONCE if most is None else most):
                self._hold_once()
            return
        times = itertools.count() if most is None else range(most)
        for _ in times:
            self._hold_once()
            if not self._holds.any_marked.numpy()[0]:
                return

    def _hold_once(self) -> None:
        marks = new_arrays.empty(self._vertex_count, dtype=wp.int32, device=self._device)
        launch(
            frame_kernels.mark_long_corrections,
            dim=self._vertex_count,
            inputs=[self._correction, self._sizes.values],
            outputs=[marks],
            device=self._device,
        )
        self._mark_turned_over(marks)
        self._stiffen(marks)

    def _stiffen(self, marks: wp.array) -> None:
        """Solve again with more stiffness at vertices marked in (C,) int32; those marked before do not move."""
        self._holds.hold(marks)
        any_marked = self._holds.any_marked
        # Only where the host need not wait.
        if device_traits(self._device).own_memory or any_marked.numpy()[0]:
            self._holds.take(self._equations.solve(self._holds, any_marked), self._correction)

    def _scale(self, marked: np.ndarray, share: float) -> None:
        """Let some vertices (C,) bool go a share of their way."""
        if marked.any():
            factor = np.where(marked, np.float32(share), np.float32(1.0))
            factors = new_arrays.uploaded(factor, dtype=wp.float32, device=self._device)
            launch(
                frame_kernels.scale_corrections,
                dim=self._vertex_count,
                inputs=[factors],
                outputs=[self._correction],
                device=self._device,
            )

    def settle(self, reach: float) -> FitSteps:
        """Hold back what comes further away than any of its component was as placed, see :data:`FitSteps`.

        Args:
            reach: as in :meth:`improve`.
        """
        attempt = 0
        while attempt < ATTEMPTS:
            begun = self._looks_ahead(attempt)
            *held, last = FarLook.from_numbers((yield begun))
            attempt += sum(self._is_complete(look) and 0 < look.far_count <= self._far_places.few for look in held)
            if not last.has_area:
                return True
            if not self._is_complete(last):
                self._complete(last)
            elif attempt < ATTEMPTS:
                if not last.far_count:
                    return True
                if last.far_count > self._far_places.few:
                    # The surfaces as they were looked at, so that others adapt to what is held.
                    self._matching.find(reach, search=True)
                    self._equations.assemble(self._matching, self._keys, self._sizes, self._correction, self._far)
                self._hold_far(begun[-int(kernels.LOOK) :], attempt, many=True)
                attempt += 1
        for share in SHARES:
            while True:
                (look,) = FarLook.from_numbers((yield self._look()))
                if not look.has_area or self._is_complete(look):
                    break
                self._complete(look)
            if not look.has_area or not look.far_count:
                break
            self.shrink_components(self._limits.sampled.far.numpy() != 0, share)
        self.leave_turned_components()
        return False

    def _looks_ahead(self, attempt: int) -> wp.array:
        """What is known of a look at all places, and of those after attempts that are made before the host looks."""
        looks = [self._look()]
        if self._works_ahead:
            for ahead in range(min(ATTEMPTS_AHEAD, ATTEMPTS - attempt)):
                self._hold_far(looks[-1], attempt + ahead)
                looks.append(self._look())
        return joined(looks)

    def _look(self) -> wp.array:
        """Look for vertices at places that are further away than any of their component was as placed."""
        self._keys.move(self._correction, self._moved)
        far = self._limits.mark_far(self._moved)
        return self._far_places.note(far, self._holds.any_marked, self._sizes.has_area, self._limits.large_count)

    def _hold_far(self, look: wp.array, attempt: int, *, many: bool = False) -> None:
        """Hold the places of a look, the last one, as the surfaces were paired last; see :meth:`FarPlaces.to_hold`."""
        far, room = self._limits.sampled.far, self._limits.room
        self._stiffen(self._far_places.to_hold(far, look, room, attempt, many=many))
        self.hold_back()

    def _is_complete(self, look: FarLook) -> bool:
        """Whether vertices were held back before as far as it takes, and there was room for all that is looked at."""
        return not look.any_held and look.large_count <= self._limits.room

    def _complete(self, look: FarLook) -> None:
        """Do what a look lacked."""
        if look.any_held:
            self.hold_back()
        else:
            self._limits.make_room(look.large_count)

    def shrink_components(self, marked: np.ndarray, share: float) -> None:
        """Move the components that some vertices (C,) bool are of by a share of what they do."""
        self._scale(self._limits.whole_components(marked), share)

    def leave_turned_components(self) -> None:
        """Leave components as placed in which part of the way turns a face over that the whole way does not."""
        marks = new_arrays.zeros(self._vertex_count, dtype=wp.int32, device=self._device)
        self._mark_turned_over(marks)
        self.shrink_components(marks.numpy() != 0, 0.0)

    def apply(self, placed: PlacedFrames) -> PlacedFrames:
        """One of the blocks of frames, moved."""
        moved = self._all_frames.of_block(placed).moved(self._correction)
        return replace(placed, points=moved.numpy() if isinstance(placed.points, np.ndarray) else moved)

    def _mark_turned_over(self, marks: wp.array) -> None:
        """Mark vertices (C,) int32 that have a part in a face that turns over in some frame."""
        for block in self._all_frames.all():
            block.mark_new_flips(self._correction, self._corner_vertex, marks)


def _is_left(vertex_map: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(N,) bool, the faces (N, 3) of which something is left by ``vertex_map`` (V,): most often all."""
    if vertex_map.min(initial=0) >= 0:
        return np.ones(len(faces), dtype=bool)
    return vertex_map[faces[:, 0]] >= 0


def _left(mesh: AnimatedMesh, is_left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The faces of a mesh that are left, (N,) bool, and the vertices that these have, ascending."""
    if is_left.all():
        return mesh.faces, np.flatnonzero(mesh.used)
    faces = mesh.faces[is_left]
    return faces, different(faces, mesh.vertex_count)
