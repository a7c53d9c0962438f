"""Layers as files: saved while they are written, the order of their fields, paths of what they name.

Imports checks.
"""
