"""Tests of `repair`."""
