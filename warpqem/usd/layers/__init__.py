"""Layers and stages as files: opened as another stage is, saved while written, paths of what they name.

Imports checks.
"""
