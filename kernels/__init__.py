"""Warp kernels and device functions of warpqem, installed as ``warpqem.kernels``.

Nothing in here knows host code: a module holds the functions and kernels of one step, and the host module that
launches them imports it. Kernels that walk a work list are written with a grid stride (``range(wp.tid(), n, stride)``),
so that the list's length can stay on the device.
"""
