"""Arguments from callers, taken in any form that holds what is meant and refused by name, and option fields.

Imports only errors.
"""
