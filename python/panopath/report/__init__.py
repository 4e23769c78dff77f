"""What a person looks at."""

from panopath.report.animation import animate_mode
from panopath.report.certificate_pictures import draw_certificate, explain
from panopath.report.page import ReportNotes, write_report
from panopath.report.pictures import draw_scene
from panopath.report.regions import Region, draw_forbidden_regions

__all__ = [
    "Region",
    "ReportNotes",
    "animate_mode",
    "draw_certificate",
    "draw_forbidden_regions",
    "draw_scene",
    "explain",
    "write_report",
]
