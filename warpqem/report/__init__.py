"""A report as one HTML file that opens offline: the meshes in motion, their errors, and what was asked for."""

from warpqem.report.content import Curve, Level, Report, Skeleton, Table
from warpqem.report.data import chosen_frames, report_data
from warpqem.report.page import report_page, write_report

__all__ = [
    "Curve",
    "Level",
    "Report",
    "Skeleton",
    "Table",
    "chosen_frames",
    "report_data",
    "report_page",
    "write_report",
]
