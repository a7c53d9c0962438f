"""Triangle meshes: checked input, polygons cut into triangles, edges, components, seams.

Imports arguments, frames, repair and runtime.
"""
