"""The place stage: where every output vertex is in every frame."""
