"""What a person looks at."""

from panopath.report.pictures import draw_scene

__all__ = ["draw_scene"]
