"""Tests of `refit`."""
