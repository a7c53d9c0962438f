"""Tests of `place`."""
