"""The `warpqem` command."""
