"""Mesh files (OBJ, PLY, STL, OFF, GLB, ...) and sequences of them, read and written through trimesh.

A part of the core, which imports it only where files are asked for; trimesh is loaded when the first one is read.
"""
