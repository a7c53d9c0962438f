"""Slow, plain NumPy float64 versions of what the kernels compute, written from the definitions."""
