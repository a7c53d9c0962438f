"""Tangent-space normal maps: tangent frames, maps baked from another surface, and maps on the device.

It imports the kernels, `runtime`, `arguments` and `mesh`; whoever draws or bakes uses it.
"""
