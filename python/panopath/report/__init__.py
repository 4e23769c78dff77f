"""What a person looks at."""

from panopath.report.animation import animate_mode
from panopath.report.certificate_pictures import draw_certificate, explain
from panopath.report.pictures import draw_scene

__all__ = ["animate_mode", "draw_certificate", "draw_scene", "explain"]
