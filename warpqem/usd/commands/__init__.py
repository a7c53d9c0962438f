"""What users ask for: simplify, compare, render, report, levels. Imports write, read, checks and the core."""
