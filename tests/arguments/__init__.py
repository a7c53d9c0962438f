"""Tests of `arguments`."""
