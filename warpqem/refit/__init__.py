"""Refit: one constant correction per output vertex, fitted to the input surface over all key frames."""
