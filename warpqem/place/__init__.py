"""Placement: where every output vertex is in every frame."""
