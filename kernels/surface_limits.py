"""How far places of two surfaces are from each other, by component of the output: the most, and where it is more."""

import warp as wp

from warpqem.kernels.surface_pairs import Pairs, Turns, own_pair
from warpqem.kernels.surface_walk import Hit, Surface, search_nearer, surface_point

wp.set_module_options({"enable_backward": False})  # no gradients are taken


@wp.struct
class Samples:
    """Samples of both surfaces and vertices of the output, as they were paired in a key frame."""

    source: Surface
    target: Surface
    source_mesh: wp.uint64  # hierarchies of both in the frame
    target_mesh: wp.uint64
    input_turns: Turns  # of all pairs of the frame
    output_turns: Turns
    input_pairs: Pairs
    output_pairs: Pairs
    input_count: wp.int32  # pairs of samples, without those of borders
    barycentric: wp.array[wp.vec3]  # of the samples of an output face
    vertex_squared: wp.array[wp.float32]  # (C,) see :func:`measure_vertex_distances`
    vertex_face: wp.array[wp.int32]  # (C,) an output face at each output vertex, -1 for none


@wp.struct
class Sample:
    """A point of one surface and how far it is, squared, from where a walk on the other one ended."""

    point: wp.vec3
    face: wp.int32  # of the output: the sample's own, or where the walk ended; -1 for no sample
    is_input: wp.bool
    vertex: wp.int32  # of the input, at the sample; -1 for one of the output
    squared: wp.float32


@wp.struct
class Limits:
    """How far the components of the output may be from the input."""

    component: wp.array[wp.int32]  # (N',) of each output face
    squared: wp.array[wp.float32]  # of each component
    vertex_component: wp.array[wp.int32]  # (V,) the component that each input vertex went to, -1 for none
    own_squared: wp.array[wp.float32]  # of each component, by samples of itself and of what went to it alone
    far: wp.array[wp.int32]  # (C,) 1 at output vertices of places that are further away


@wp.func
def paired_sample(samples: Samples, i: wp.int32) -> Sample:
    """The ``i``-th one of samples of the input, of those of the output and of its vertices."""
    t = samples.input_turns.key
    sample = Sample()
    sample.face = wp.int32(-1)
    sample.vertex = wp.int32(-1)
    sample.is_input = i < samples.input_turns.per_key
    on_output = i - samples.input_turns.per_key
    v = on_output - samples.output_turns.per_key
    if sample.is_input:
        pair = own_pair(samples.input_turns, t, i)
        if pair < samples.input_count and samples.input_pairs.squared[pair] > 0.0:
            face_count = samples.source.corner_vertex.shape[0] / 3
            own = pair / samples.input_turns.count
            sample.face = samples.input_pairs.near[pair]
            sample.squared = samples.input_pairs.squared[pair]
            if own < face_count:
                sample.point = surface_point(samples.source, t, own, wp.vec3(1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0))
                sample.vertex = samples.source.corner_vertex[3 * own]
            else:
                sample.point = samples.source.points[t, own - face_count]
                sample.vertex = own - face_count
    elif v < 0:
        pair = own_pair(samples.output_turns, t, on_output)
        if pair < samples.output_pairs.squared.shape[0]:
            own = pair / samples.output_turns.count
            per_face = samples.barycentric.shape[0]
            sample.face = own / per_face
            sample.squared = samples.output_pairs.squared[pair]
            sample.point = surface_point(samples.target, t, sample.face, samples.barycentric[own % per_face])
    else:
        sample.face = samples.vertex_face[v]
        sample.squared = samples.vertex_squared[v]
        sample.point = samples.target.points[t, v]
    return sample


@wp.func
def nearest_squared(samples: Samples, sample: Sample) -> wp.float32:
    """Squared distance of a sample from the other surface, to whose nearest point a walk need not have come."""
    t = samples.input_turns.key
    nearest = sample.squared
    hit = Hit()
    hit.face = wp.int32(-1)
    hit.squared = sample.squared
    if sample.is_input:
        hit = search_nearer(samples.target_mesh, sample.point, hit)
        if hit.face >= 0:
            nearest = wp.length_sq(sample.point - surface_point(samples.target, t, hit.face, hit.barycentric))
    else:
        hit = search_nearer(samples.source_mesh, sample.point, hit)
        if hit.face >= 0:
            nearest = wp.length_sq(sample.point - surface_point(samples.source, t, hit.face, hit.barycentric))
    return wp.min(nearest, sample.squared)


@wp.kernel
def raise_limits(
    # in
    samples: Samples,
    # in and out
    limits: Limits,
):
    """Raise the limits of each component to the largest squared distance of its samples in a key frame.

    One counts samples of the input whose nearest face is of the component, the other those alone that went to it.
    Only where a walk ends further away than that a search is needed: at few samples, whatever their order.
    """
    sample = paired_sample(samples, wp.tid())
    if sample.face >= 0:
        component = limits.component[sample.face]
        is_own = sample.vertex < 0
        if not is_own:
            is_own = limits.vertex_component[sample.vertex] == component
        least = limits.squared[component]
        if is_own:
            least = wp.min(least, limits.own_squared[component])
        if sample.squared > least:
            squared = nearest_squared(samples, sample)
            wp.atomic_max(limits.squared, component, squared)
            if is_own:
                wp.atomic_max(limits.own_squared, component, squared)


@wp.kernel
def mark_far_samples(
    # in
    samples: Samples,
    # in and out
    limits: Limits,
):
    """Mark the vertices of output faces with a sample further away in a key frame than their component may be."""
    sample = paired_sample(samples, wp.tid())
    if sample.face >= 0:
        limit = limits.squared[limits.component[sample.face]]
        if sample.squared > limit and nearest_squared(samples, sample) > limit:
            for k in range(3):
                limits.far[samples.target.corner_vertex[3 * sample.face + k]] = 1


@wp.struct
class PlacesOfVertices:
    """Places, each of them some points, with the output vertices that it belongs to."""

    vertex: wp.array2d[wp.int32]  # (n, 1) or (n, 3)
    points: wp.int32  # of each place
    component: wp.array[wp.int32]  # (C,) of each output vertex


@wp.func
def place_component(places: PlacesOfVertices, i: wp.int32) -> wp.int32:
    """The component that the ``i``-th point is held to."""
    return places.component[places.vertex[i / places.points, 0]]


@wp.kernel
def gather_limits(
    # in
    places: PlacesOfVertices,
    own_squared_in: wp.array[wp.float32],
    growth: wp.float32,
    # out
    squared_out: wp.array[wp.float32],
):
    """The squared limit of each point: ``growth`` times the distance of its component."""
    i = wp.tid()
    limit = growth * wp.sqrt(own_squared_in[place_component(places, i)])
    squared_out[i] = limit * limit


@wp.kernel
def raise_own_limits(
    # in
    places: PlacesOfVertices,
    squared_in: wp.array[wp.float32],
    # in and out
    own_squared: wp.array[wp.float32],
):
    """Raise the limit of each component to the largest squared distance of its points."""
    i = wp.tid()
    component = place_component(places, i)
    if squared_in[i] > own_squared[component]:
        wp.atomic_max(own_squared, component, squared_in[i])


@wp.kernel
def mark_far_places(
    # in
    places: PlacesOfVertices,
    squared_in: wp.array[wp.float32],
    own_squared_in: wp.array[wp.float32],
    growth: wp.float32,
    # in and out
    far: wp.array[wp.int32],
):
    """Mark the vertices of places with a point further away than ``growth`` times the distance of their component."""
    i = wp.tid()
    if wp.sqrt(squared_in[i]) > growth * wp.sqrt(own_squared_in[place_component(places, i)]):
        for k in range(places.vertex.shape[1]):
            far[places.vertex[i / places.points, k]] = 1
