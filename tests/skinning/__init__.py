"""Tests of `skinning`."""
