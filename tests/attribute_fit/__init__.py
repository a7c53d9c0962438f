"""Tests of `attribute_fit`."""
