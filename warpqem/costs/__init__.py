"""What a collapse costs: cost models, weights of vertices and frames, motion features, attributes.

Imports arguments, mesh, frames and runtime.
"""
