"""Decimation: which edges collapse, decided on the key frames."""
