"""The order stage: which edges collapse, decided on the key frames."""
