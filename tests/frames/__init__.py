"""Tests of `frames`."""
