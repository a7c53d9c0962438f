"""Tests of `progressive`."""
