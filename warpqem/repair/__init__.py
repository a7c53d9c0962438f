"""Topology that is dirty, made fit for decimation on a copy: repeated faces, mixed winding, non-manifold edges.

It imports the input checks of the core and the kernels that classify vertices; decimation and USD import it.
"""
