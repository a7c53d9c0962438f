"""Tests of `mesh_files`."""
