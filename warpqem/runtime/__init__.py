"""Devices, launches of kernels, threads, and what this process may take. Imports only errors."""
