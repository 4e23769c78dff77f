"""What a person looks at."""

from panopath.report.pictures import draw_scene
from panopath.report.regions import Region, draw_forbidden_regions

__all__ = ["Region", "draw_forbidden_regions", "draw_scene"]
