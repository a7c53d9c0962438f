"""Tests of `mesh`."""
