"""Tests of `decimation`."""
