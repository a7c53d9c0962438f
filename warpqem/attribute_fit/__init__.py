"""Attribute fit: normals, texture coordinates and colours of the output, fitted to the input by least squares.

It knows results and where they get their values from (`warpqem.pipeline`), and no USD.
"""
