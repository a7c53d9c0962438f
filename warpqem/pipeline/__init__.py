"""From points and faces to the result: preparation, memory plan, decimation, placing, bounds, levels, symmetry.

Imports every other room of the core; of these only progressive, report and face use it.
"""
