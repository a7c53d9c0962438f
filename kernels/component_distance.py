"""How far samples of one component of a mesh are from the components around it."""

import warp as wp

from warpqem.kernels.closest_point import closest_barycentric, offset_squared

# No gradients are taken. Loops stay loops: unrolled, one inside another, they take ten times as long to compile.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

# Components kept for each sample: those around a part that go before it leave others to stand for it.
NEAR_COMPONENTS = wp.constant(wp.int32(6))
NearComponents = wp.types.vector(length=int(NEAR_COMPONENTS), dtype=wp.int32)
NearDistances = wp.types.vector(length=int(NEAR_COMPONENTS), dtype=wp.float32)
# Boxes of a search, each twice as wide as the one before: the last one is a thousand times the first.
MAX_BOXES = wp.constant(wp.int32(11))
# Boxes looked at after the first with another component. With 390 parts 2 in place of 1 take 1.2 times the time of the
# whole order and change nothing.
MORE_BOXES = wp.constant(wp.int32(1))


@wp.struct
class Near:
    """The components nearest to a sample, the nearest first, of two as near the first one; -1 for none."""

    component: NearComponents
    squared: NearDistances


@wp.func
def no_component() -> Near:
    """None found yet."""
    near = Near()
    for k in range(NEAR_COMPONENTS):
        near.component[k] = wp.int32(-1)
        near.squared[k] = wp.float32(wp.inf)
    return near


@wp.func
def precedes(squared: wp.float32, component: wp.int32, other_squared: wp.float32, other: wp.int32) -> wp.bool:
    """Whether one component comes before another one, whatever the order of the search."""
    return squared < other_squared or (squared == other_squared and component < other)


@wp.func
def with_component(near: Near, component: wp.int32, squared: wp.float32) -> Near:
    """The same with one more face of a component at a squared distance."""
    place = wp.int32(NEAR_COMPONENTS) - 1
    for k in range(NEAR_COMPONENTS):
        if near.component[k] == component:
            place = k
    if precedes(squared, component, near.squared[place], near.component[place]):
        while place > 0 and precedes(squared, component, near.squared[place - 1], near.component[place - 1]):
            near.component[place] = near.component[place - 1]
            near.squared[place] = near.squared[place - 1]
            place -= 1
        near.component[place] = component
        near.squared[place] = squared
    return near


@wp.kernel
def find_near_components(
    # in
    mesh: wp.uint64,
    component_in: wp.array[wp.int32],
    sample_in: wp.array[wp.int32],
    radius_in: wp.array[wp.float32],
    # out
    near_out: wp.array2d[wp.int32],
    squared_out: wp.array2d[wp.float32],
):
    """The components nearest to each sample, (n, NEAR_COMPONENTS), -1 for none, and the squared distances of them.

    ``component_in`` (V,) is the component of each vertex, ``sample_in`` (n,) are vertices, and ``radius_in`` (n,) is
    half the size of the first box around each.
    """
    i = wp.tid()
    v = sample_in[i]
    own = component_in[v]
    p = wp.mesh_get(mesh).points[v]
    near = no_component()
    radius = radius_in[i]
    boxes_left = wp.int32(MAX_BOXES)
    more_boxes = wp.int32(MORE_BOXES)
    while boxes_left > 0:
        boxes_left -= 1
        near = no_component()
        extent = wp.vec3(radius, radius, radius)
        query = wp.mesh_query_aabb(mesh, p - extent, p + extent)
        face = wp.int32(0)
        while wp.mesh_query_next(query, face):
            first = wp.mesh_get(mesh).indices[3 * face]
            if component_in[first] != own:
                a = wp.mesh_get(mesh).points[first]
                b = wp.mesh_get(mesh).points[wp.mesh_get(mesh).indices[3 * face + 1]]
                c = wp.mesh_get(mesh).points[wp.mesh_get(mesh).indices[3 * face + 2]]
                squared = offset_squared(p, a, b, c, closest_barycentric(p, a, b, c))
                # Outside the ball nearer ones may be missing.
                if squared <= radius * radius:
                    near = with_component(near, component_in[first], squared)
        if near.component[0] >= 0:
            boxes_left = wp.min(boxes_left, more_boxes)
            more_boxes -= 1
        if near.component[NEAR_COMPONENTS - 1] >= 0:
            boxes_left = wp.int32(0)
        radius = 2.0 * radius
    for k in range(NEAR_COMPONENTS):
        near_out[i, k] = near.component[k]
        squared_out[i, k] = near.squared[k]
