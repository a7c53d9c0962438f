"""Meshes, poses, skins, seams and values read from a stage. Imports layers, checks and the core."""
