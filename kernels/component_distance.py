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
    near = NearComponents()
    squared = NearDistances()
    found = wp.int32(0)
    radius = radius_in[i]
    boxes_left = wp.int32(MAX_BOXES)
    more_boxes = wp.int32(MORE_BOXES)
    while boxes_left > 0:
        boxes_left -= 1
        for k in range(NEAR_COMPONENTS):
            near[k] = wp.int32(-1)
            squared[k] = wp.float32(wp.inf)
        extent = wp.vec3(radius, radius, radius)
        query = wp.mesh_query_aabb(mesh, p - extent, p + extent)
        face = wp.int32(0)
        while wp.mesh_query_next(query, face):
            first = wp.mesh_get(mesh).indices[3 * face]
            other = component_in[first]
            if other != own:
                a = wp.mesh_get(mesh).points[first]
                b = wp.mesh_get(mesh).points[wp.mesh_get(mesh).indices[3 * face + 1]]
                c = wp.mesh_get(mesh).points[wp.mesh_get(mesh).indices[3 * face + 2]]
                distance = offset_squared(p, a, b, c, closest_barycentric(p, a, b, c))
                # Outside the ball nearer ones may be missing.
                if distance <= radius * radius:
                    place = wp.int32(NEAR_COMPONENTS) - 1
                    for k in range(NEAR_COMPONENTS):
                        if near[k] == other:
                            place = k
                    # Of two components as near the first comes first, so that the order of the search does not count.
                    if distance < squared[place] or (distance == squared[place] and other < near[place]):
                        near[place] = other
                        squared[place] = distance
                        while place > 0 and (
                            squared[place] < squared[place - 1]
                            or (squared[place] == squared[place - 1] and near[place] < near[place - 1])
                        ):
                            swapped = near[place - 1]
                            swapped_squared = squared[place - 1]
                            near[place - 1] = near[place]
                            squared[place - 1] = squared[place]
                            near[place] = swapped
                            squared[place] = swapped_squared
                            place -= 1
        found = wp.int32(0)
        for k in range(NEAR_COMPONENTS):
            if near[k] >= 0:
                found += 1
        if found > 0:
            boxes_left = wp.min(boxes_left, more_boxes)
            more_boxes -= 1
        if found == NEAR_COMPONENTS:
            boxes_left = wp.int32(0)
        radius = 2.0 * radius
    for k in range(NEAR_COMPONENTS):
        near_out[i, k] = near[k]
        squared_out[i, k] = squared[k]
