"""Frames of a moving mesh: sources, sinks, blocks on the device, and checks on the way.

Imports arguments and runtime.
"""
