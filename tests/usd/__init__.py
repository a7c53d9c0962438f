"""Tests of `usd`."""
