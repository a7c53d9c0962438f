"""How far places of two surfaces are from each other, by component of the output: the most, and where it is more."""

import warp as wp

from warpqem.kernels.surface_pairs import Pairs, Turns, own_pair
from warpqem.kernels.surface_walk import Hit, Surface, closest_hit, search_nearer, surface_point

wp.set_module_options({"enable_backward": False})  # no gradients are taken

# Distances, their sums and squares may be off by this part of them: ten times what single precision rounds.
ROUNDING = wp.constant(wp.float32(1.0e-6))


@wp.struct
class Samples:
    """Samples of both surfaces, as they were paired, and vertices of the output, in the key frames."""

    source: Surface
    target: Surface
    source_mesh: wp.uint64  # hierarchies of both in the frame that is looked at; 0 for none
    target_mesh: wp.uint64
    input_turns: Turns  # of all pairs of a frame
    output_turns: Turns
    input_pairs: Pairs
    output_pairs: Pairs
    input_count: wp.int32  # pairs of samples, without those of borders
    barycentric: wp.array[wp.vec3]  # of the samples of an output face
    vertex_squared: wp.array2d[wp.float32]  # (K, C) see :func:`measure_vertex_distances`
    vertex_near: wp.array2d[wp.int32]  # (K, C) likewise
    vertex_face: wp.array[wp.int32]  # (C,) an output face at each output vertex, -1 for none


@wp.struct
class Sample:
    """A point of one surface, see :func:`sample_point`, and how far it is at most, squared, from the other one."""

    face: wp.int32  # of the output: the sample's own, or where the walk ended; -1 for no sample
    near: wp.int32  # of the other surface: where the walk ended
    is_input: wp.bool
    vertex: wp.int32  # of the input, at the sample; -1 for one of the output
    pair: wp.int32  # -1 for a vertex of the output
    own: wp.int32  # which sample of its surface it is, or which vertex of the output
    squared: wp.float32


@wp.struct
class Limits:
    """How far the components of the output may be from the input."""

    component: wp.array[wp.int32]  # (N',) of each output face
    squared: wp.array[wp.float32]  # of each component
    vertex_component: wp.array[wp.int32]  # (V,) the component that each input vertex went to, -1 for none
    own_squared: wp.array[wp.float32]  # of each component, by samples of itself and of what went to it alone
    frame_scale: wp.array[wp.float32]  # (K,) what multiplies such distances in each key frame before they are compared
    far: wp.array[wp.int32]  # (C,) 1 at output vertices of places that are further away


@wp.func
def is_beyond(squared: wp.float32, limit: wp.float32) -> wp.bool:
    """Whether a squared distance is more than one that it may be, and not by rounding."""
    return squared > (1.0 + ROUNDING) * limit


@wp.func
def paired_sample(samples: Samples, t: wp.int32, i: wp.int32) -> Sample:
    """The ``i``-th one of samples of the input, of those of the output and of its vertices in key frame ``t``."""
    sample = Sample()
    sample.face = wp.int32(-1)
    sample.near = wp.int32(-1)
    sample.vertex = wp.int32(-1)
    sample.pair = wp.int32(-1)
    sample.is_input = i < samples.input_turns.per_key
    v = i - samples.input_turns.per_key - samples.output_turns.per_key
    if sample.is_input:
        pair = own_pair(samples.input_turns, t, i)
        if pair < samples.input_count and samples.input_pairs.near[pair] >= 0:
            face_count = samples.source.corner_vertex.shape[0] / 3
            own = pair / samples.input_turns.count
            sample.pair = pair
            sample.own = own
            sample.near = samples.input_pairs.near[pair]
            sample.face = sample.near
            sample.squared = samples.input_pairs.squared[pair]
            sample.vertex = own - face_count
            if own < face_count:
                sample.vertex = samples.source.corner_vertex[3 * own]
    elif v < 0:
        pair = own_pair(samples.output_turns, t, i - samples.input_turns.per_key)
        if pair < samples.output_pairs.squared.shape[0]:
            sample.pair = pair
            sample.own = pair / samples.output_turns.count
            sample.near = samples.output_pairs.near[pair]
            sample.face = sample.own / samples.barycentric.shape[0]
            sample.squared = samples.output_pairs.squared[pair]
    else:
        sample.own = v
        sample.near = samples.vertex_near[t, v]
        sample.face = samples.vertex_face[v]
        sample.squared = samples.vertex_squared[t, v]
    return sample


@wp.func
def sample_point(samples: Samples, t: wp.int32, sample: Sample) -> wp.vec3:
    """Where a sample is in key frame ``t``."""
    if sample.is_input:
        face_count = samples.source.corner_vertex.shape[0] / 3
        if sample.own < face_count:
            return surface_point(samples.source, t, sample.own, wp.vec3(1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0))
        return samples.source.points[t, sample.own - face_count]
    if sample.pair >= 0:
        barycentric = samples.barycentric[sample.own % samples.barycentric.shape[0]]
        return surface_point(samples.target, t, sample.face, barycentric)
    return samples.target.points[t, sample.own]


@wp.func
def nearest_squared(samples: Samples, t: wp.int32, sample: Sample) -> wp.float32:
    """Squared distance of a sample from the other surface, to whose nearest point a walk need not have come."""
    nearest = sample.squared
    point = sample_point(samples, t, sample)
    hit = Hit()
    hit.face = wp.int32(-1)
    hit.squared = sample.squared
    if sample.is_input:
        hit = search_nearer(samples.target_mesh, point, hit)
        if hit.face >= 0:
            nearest = wp.length_sq(point - surface_point(samples.target, t, hit.face, hit.barycentric))
    else:
        hit = search_nearer(samples.source_mesh, point, hit)
        if hit.face >= 0:
            nearest = wp.length_sq(point - surface_point(samples.source, t, hit.face, hit.barycentric))
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
    t = samples.input_turns.key
    sample = paired_sample(samples, t, wp.tid())
    if sample.face >= 0:
        component = limits.component[sample.face]
        is_own = sample.vertex < 0
        if not is_own:
            is_own = limits.vertex_component[sample.vertex] == component
        scale = limits.frame_scale[t] * limits.frame_scale[t]
        if sample.squared > limits.squared[component] or (
            is_own and scale * sample.squared > limits.own_squared[component]
        ):
            squared = nearest_squared(samples, t, sample)
            wp.atomic_max(limits.squared, component, squared)
            if is_own:
                wp.atomic_max(limits.own_squared, component, scale * squared)


@wp.kernel
def mark_far_samples(
    # in
    samples: Samples,
    # in and out
    limits: Limits,
):
    """Mark the vertices of output faces with a sample further away in a key frame than their component may be."""
    t = samples.input_turns.key
    sample = paired_sample(samples, t, wp.tid())
    if sample.face >= 0:
        limit = limits.squared[limits.component[sample.face]]
        if is_beyond(sample.squared, limit) and is_beyond(nearest_squared(samples, t, sample), limit):
            for k in range(3):
                limits.far[samples.target.corner_vertex[3 * sample.face + k]] = 1


@wp.func
def most_squared(squared: wp.float32, step: wp.float32) -> wp.float32:
    """What a squared distance is at most, when either end has moved by ``step``."""
    most = (1.0 + ROUNDING) * (wp.sqrt(squared) + (1.0 + ROUNDING) * step)
    return most * most


@wp.kernel
def move_vertices(
    # in
    points_in: wp.array2d[wp.vec3],
    # in and out
    before: wp.array2d[wp.vec3],
    vertex_squared: wp.array2d[wp.float32],
):
    """Bring ``before`` (K, C) to where vertices are now, and squared distances to the most that they may be there."""
    t, c = wp.tid()
    step = wp.length(points_in[t, c] - before[t, c])
    vertex_squared[t, c] = most_squared(vertex_squared[t, c], step)
    before[t, c] = points_in[t, c]


@wp.kernel
def update_distances(
    # in
    first_key: wp.int32,
    before_in: wp.array2d[wp.vec3],
    limits: Limits,
    # in and out
    samples: Samples,
    # out
    beyond_out: wp.array[wp.int32],
):
    """Bring the distances of all samples and vertices (K, n) to where the output is, which was at ``before_in`` (K, C).

    A face takes what is on it, or near to it, no further than its corners go. Where that may be further away than its
    component may be, a walk begins where the last one ended; 1 for key frames (K,) in which one ends beyond.
    """
    k, i = wp.tid()
    t = first_key + k
    sample = paired_sample(samples, t, i)
    if sample.face < 0 or sample.near < 0:
        return
    step = wp.float32(0.0)
    if sample.pair >= 0:
        for corner in range(3):
            c = samples.target.corner_vertex[3 * sample.face + corner]
            step = wp.max(step, wp.length(samples.target.points[t, c] - before_in[t, c]))
    else:
        step = wp.length(samples.target.points[t, sample.own] - before_in[t, sample.own])
    squared = most_squared(sample.squared, step)
    near = sample.near
    limit = limits.squared[limits.component[sample.face]]
    if is_beyond(squared, limit):
        nowhere = wp.vec3i(-1, -1, -1)
        point = sample_point(samples, t, sample)
        hit = Hit()
        if sample.is_input:
            hit = closest_hit(samples.target, t, nowhere, near, point)
            squared = wp.length_sq(point - surface_point(samples.target, t, hit.face, hit.barycentric))
            limit = limits.squared[limits.component[hit.face]]
        else:
            hit = closest_hit(samples.source, t, nowhere, near, point)
            squared = wp.length_sq(point - surface_point(samples.source, t, hit.face, hit.barycentric))
        near = hit.face
        if is_beyond(squared, limit):
            beyond_out[t] = 1
    if sample.is_input:
        samples.input_pairs.near[sample.pair] = near
        samples.input_pairs.squared[sample.pair] = squared
    elif sample.pair >= 0:
        samples.output_pairs.near[sample.pair] = near
        samples.output_pairs.squared[sample.pair] = squared
    else:
        samples.vertex_near[t, sample.own] = near
        samples.vertex_squared[t, sample.own] = squared


@wp.struct
class PlacesOfVertices:
    """Places, each of them some points, with the output vertices that it belongs to."""

    vertex: wp.array2d[wp.int32]  # (n, 1) or (n, 3); negative for no place
    points: wp.int32  # of each place
    component: wp.array[wp.int32]  # (C,) of each output vertex


@wp.func
def place_component(places: PlacesOfVertices, i: wp.int32) -> wp.int32:
    """The component that the ``i``-th point is held to; -1 for none."""
    vertex = places.vertex[i / places.points, 0]
    component = wp.int32(-1)
    if vertex >= 0:
        component = places.component[vertex]
    return component


@wp.kernel
def begin_at_vertices(
    # in
    vertex_nearest_in: wp.array[wp.int32],
    vertex_in: wp.array[wp.int32],
    # out
    nearest_out: wp.array[wp.int32],
):
    """Let looks at points begin where that of a vertex (n,) near to each ended."""
    i = wp.tid()
    nearest_out[i] = vertex_nearest_in[vertex_in[i]]


@wp.kernel
def gather_limits(
    # in
    places: PlacesOfVertices,
    own_squared_in: wp.array[wp.float32],
    growth: wp.float32,
    step_in: wp.array[wp.float32],
    # in and out
    most: wp.array[wp.float32],
    # out
    squared_out: wp.array[wp.float32],
):
    """The squared limit of each point: ``growth`` times the distance of its component.

    ``most`` (n,), what each is away at most, squared, grows by how far vertices of the component have gone. Points that
    are within their limit by that, or of no place, get a negative one.
    """
    i = wp.tid()
    component = place_component(places, i)
    if component < 0:
        squared_out[i] = -1.0
        return
    limit = growth * wp.sqrt(own_squared_in[component])
    most[i] = most_squared(most[i], step_in[component])
    squared_out[i] = wp.where(most[i] > limit * limit, limit * limit, -1.0)


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
    if component >= 0 and squared_in[i] > own_squared[component]:
        wp.atomic_max(own_squared, component, squared_in[i])


@wp.kernel
def mark_far_places(
    # in
    places: PlacesOfVertices,
    squared_in: wp.array[wp.float32],
    within_in: wp.array[wp.float32],
    # in and out
    most: wp.array[wp.float32],
    far: wp.array[wp.int32],
):
    """Mark the vertices of places with a point further away than its limit ``within_in`` (n,), both squared.

    ``most`` (n,) becomes the distance of those that were looked at, see :func:`gather_limits`.
    """
    i = wp.tid()
    if within_in[i] >= 0.0:
        most[i] = squared_in[i]
        if is_beyond(squared_in[i], within_in[i]):
            for k in range(places.vertex.shape[1]):
                far[places.vertex[i / places.points, k]] = 1
