"""Benchmarks: the same work through warpqem and its peers, in turn. ``python -m benchmarks --help``."""
