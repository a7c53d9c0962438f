"""What users ask for: simplify, compare, render, report, levels. Imports the other rooms of USD and the core."""
