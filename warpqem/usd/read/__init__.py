"""Meshes, poses, skins, seams and values read from a stage. Imports checks and the core."""
