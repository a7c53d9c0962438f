"""Files: what is at a path, temporary files beside outputs, and outputs that must not be inputs.

Imports errors and runtime.
"""
