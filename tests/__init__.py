"""Tests of warpqem, in folders like its code."""
