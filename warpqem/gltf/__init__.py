"""Animated glTF files in and out, by way of Blender's module in a process of its own, and what the way keeps of them.

Imports usd, pipeline and the rooms below; Blender imports `blender_script`, which knows nothing of warpqem.
"""
