"""The points of one moving mesh that lie over the material points of another, followed from frame to frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import warp as wp

from warpqem.measure.binding_surface import WALK_STEPS, facing_sign, make_rings, nearest_facing, walk
from warpqem.measure.checked_meshes import CheckedMesh
from warpqem.measure.closest_points import ClosestPointSearch
from warpqem.measure.coincidence import coincident
from warpqem.measure.sampling import MaterialSamples, normals_and_areas, place
from warpqem.runtime import new_arrays

__all__ = ["Correspondence", "MovingMesh", "match_islands"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# Frames that decide which vertices are at one place: those that only touch in one are not.
PLACE_FRAMES = 3

# A point on another island, or of a face that faces the other way, is given up for one no further away than this, in
# diagonals: parts that a simplified mesh lost have none.
REACH = 0.05

# A walk that ends this much further away than it began, in diagonals, may be stuck at a fold, and is searched anew.
STUCK = 0.002

# Points inside a face, towards each corner and in the middle, that decide which island of the other mesh it lies on.
INSIDE = np.array([[0.6, 0.2, 0.2], [0.2, 0.6, 0.2], [0.2, 0.2, 0.6], [1 / 3, 1 / 3, 1 / 3]])

# An island whose faces agree to this part of their area goes as a whole: single faces err next to a seam.
MOSTLY = 0.9


class MovingMesh:
    """A mesh sequence, one frame of it on the device, scaled to unit diagonal around the origin.

    Attributes:
        mesh: the sequence.
        place: (N, 3) int64, equal for corners that are at the same place throughout.
        points: (V, 3) of the frame shown, scaled.
    """

    def __init__(self, mesh: CheckedMesh, centre: Floats, diagonal: Floats, device: str) -> None:
        self.mesh, self.device = mesh, device
        self._centre, self._diagonal = centre, diagonal
        frames = np.unique(np.linspace(0, len(mesh.points) - 1, PLACE_FRAMES).round().astype(np.int64))
        self.place: Ints = coincident(mesh.points[frames])[mesh.faces]
        self.corner_vertex = new_arrays.uploaded(mesh.faces.ravel(), dtype=wp.int32, device=device)
        self._mesh: wp.Mesh | None = None
        self.show(0)

    def show(self, frame: int) -> None:
        """Go to a frame."""
        self.points: Floats = (self.mesh.points[frame].astype(np.float64) - self._centre[frame]) / self._diagonal[frame]
        self.exact = new_arrays.uploaded(self.points, dtype=wp.vec3d, device=self.device)
        self._is_fitted = False

    def hierarchy(self) -> wp.Mesh:
        """The hierarchy of the frame shown: built once, refitted in later frames in which it is asked for."""
        if not self._is_fitted:
            single = new_arrays.uploaded(self.points, dtype=wp.vec3, device=self.device)
            if self._mesh is None:
                self._mesh = wp.Mesh(points=single, indices=self.corner_vertex)
            else:
                # Setting the points refits it.
                self._mesh.points = single
            self._is_fitted = True
        return self._mesh


class Correspondence:
    """Points of a target over material points of a source, of the same island and facing the same way.

    They are searched for in the first frame; from there on each is followed by a walk over the target, so that it does
    not come to lie on another leg that comes near.

    Attributes:
        face: (S,) int64, faces of the target in the frame shown.
        barycentric: (S, 3) float64.
    """

    def __init__(
        self,
        source: MovingMesh,
        target: MovingMesh,
        samples: MaterialSamples,
        islands: tuple[Ints, Ints] | None = None,
    ) -> None:
        """Search, with both meshes at the first frame.

        Args:
            source: has the samples.
            target: is searched.
            samples: S material points of the source.
            islands: (N,) and (N',) the islands of the source's faces and of the target's, numbered alike; None for one.
        """
        self._source, self._target, self._samples = source, target, samples
        if islands is None:
            islands = np.zeros(len(source.mesh.faces), dtype=np.int64), np.zeros(len(target.mesh.faces), dtype=np.int64)
        self._label, self._wanted = islands[1], islands[0][samples.face]
        # Walks stay on an island: corners of different ones are not next to each other.
        _, corner_place = np.unique(
            target.place * (int(self._label.max()) + 1) + self._label[:, None], return_inverse=True
        )
        self._rings = make_rings(corner_place.ravel(), target.device)
        query = self._queries()
        search = ClosestPointSearch(target.mesh.faces, target.device, "target")
        closest = search.closest(target.points, query, 0)
        face = self._searched(closest.face.astype(np.int64), query, closest.distance, np.full(len(query), REACH))
        self.face, self.barycentric, self._first = self._walk(face, query)

    def follow(self) -> None:
        """Go on to the frame that both meshes show now."""
        query = self._queries()
        self.face, self.barycentric, distance = self._walk(self.face, query)
        stuck = np.flatnonzero(distance > self._first + STUCK)
        if not len(stuck):
            return
        found = self._nearest(stuck, query[stuck], np.zeros(len(stuck)), distance[stuck])
        stuck, found = stuck[found >= 0], found[found >= 0]
        face, barycentric, nearer = self._walk(found, query[stuck])
        better = nearer < distance[stuck]
        self.face[stuck[better]], self.barycentric[stuck[better]] = face[better], barycentric[better]

    def target_points(self) -> Floats:
        """The points (S, 3) on the target in the frame shown, scaled."""
        return place(self._target.points, self._target.mesh.faces, self.face, self.barycentric)

    def _queries(self) -> Floats:
        return place(self._source.points, self._source.mesh.faces, self._samples.face, self._samples.barycentric)

    def _walk(self, face: Ints, query: Floats) -> tuple[Ints, Floats, Floats]:
        target = self._target
        found, where = walk(target.exact, target.corner_vertex, self._rings, face, query, WALK_STEPS)
        return found, where, np.linalg.norm(place(target.points, target.mesh.faces, found, where) - query, axis=1)

    def _searched(self, face: Ints, query: Floats, distance: Floats, reach: Floats) -> Ints:
        """The nearest faces; for those of another island or that face the other way another one, if it is in reach."""
        normal = normals_and_areas(self._source.points, self._source.mesh.faces[self._samples.face])[0]
        other = normals_and_areas(self._target.points, self._target.mesh.faces[face])[0]
        along = (normal * other).sum(axis=1)
        self._sign = facing_sign(along, distance)
        wrong = (self._sign * along < 0) | (self._label[face] != self._wanted)
        chosen = np.flatnonzero(wrong)
        if len(chosen):
            found = self._nearest(chosen, query[chosen], distance[chosen], np.maximum(reach, 2 * distance)[chosen])
            face[chosen] = np.where(found >= 0, found, face[chosen])
        return face

    def _nearest(self, chosen: Ints, query: Floats, distance: Floats, reach: Floats) -> Ints:
        """The nearest face of the island of some samples (C,) that faces as they do; -1 where none is in reach."""
        corner = self._source.mesh.faces[self._samples.face[chosen]]
        normal = self._sign * normals_and_areas(self._source.points, corner)[0]
        target, labels = self._target, (self._label, self._wanted[chosen])
        found = nearest_facing(
            target.points,
            target.corner_vertex,
            query,
            normal,
            distance,
            reach,
            target.device,
            labels,
            target.hierarchy(),
        )
        return found


def match_islands(reference: MovingMesh, test: MovingMesh, reference_island: Ints, test_island: Ints) -> Ints:
    """The island of the reference that each face of the test mesh (N',) lies on, with both at the first frame.

    Points inside a face vote by what they are nearest to; islands of the test mesh that mostly agree go as a whole.
    """
    faces = test.mesh.faces
    face = np.repeat(np.arange(len(faces)), len(INSIDE))
    query = place(test.points, faces, face, np.tile(INSIDE, (len(faces), 1)))
    search = ClosestPointSearch(reference.mesh.faces, reference.device, "reference")
    closest = search.closest(reference.points, query, 0)
    nearest = closest.face.astype(np.int64)
    normal, area = normals_and_areas(test.points, faces)
    other = normals_and_areas(reference.points, reference.mesh.faces[nearest])[0]
    along = (normal[face] * other).sum(axis=1)
    sign = facing_sign(along, closest.distance)
    against = np.flatnonzero(sign * along < 0)
    if len(against):
        found = nearest_facing(
            reference.points,
            reference.corner_vertex,
            query[against],
            sign * normal[face[against]],
            closest.distance[against],
            np.maximum(REACH, 2 * closest.distance[against]),
            reference.device,
        )
        nearest[against] = np.where(found >= 0, found, nearest[against])
    vote = reference_island[nearest]
    # A face without area still has a vote.
    weight = area[face] + np.finfo(np.float64).tiny
    by_face, _ = _elected(face, vote, weight, len(faces))
    by_island, share = _elected(test_island[face], vote, weight, int(test_island.max()) + 1)
    return np.where(share[test_island] >= MOSTLY, by_island[test_island], by_face)


def _elected(voter: Ints, vote: Ints, weight: Floats, count: int) -> tuple[Ints, Floats]:
    """What most of the weight of each voter (0 to count) is for, and the share that is."""
    choices = int(vote.max()) + 1
    key, slot = np.unique(voter * choices + vote, return_inverse=True)
    total = np.bincount(slot.ravel(), weight)
    order = np.lexsort((total, key // choices))
    last = order[np.append(key[order][1:] // choices != key[order][:-1] // choices, True)]
    winner, share = np.zeros(count, dtype=np.int64), np.zeros(count)
    winner[key[last] // choices] = key[last] % choices
    share[key[last] // choices] = total[last] / np.bincount(voter, weight, count)[key[last] // choices]
    return winner, share
