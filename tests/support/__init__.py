"""What tests share: stages, meshes, traps, checks. Imports no test."""
