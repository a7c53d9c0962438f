"""Simplified meshes and what belongs to them written to layers, files and packages. Imports read, layers and checks."""
