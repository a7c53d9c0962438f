"""Seeded procedural generators of the animated test scenes kept in this folder."""
