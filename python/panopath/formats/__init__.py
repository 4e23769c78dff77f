"""Files in and out: one file a format. :func:`read_tracks` recognises a file by what is in it."""

from panopath.formats.colours import point_colours
from panopath.formats.crops import CropOptions, Crops, write_crops
from panopath.formats.csv import read_control, write_tracks
from panopath.formats.database import Database, read_database
from panopath.formats.detect import read_problem, read_tracks
from panopath.formats.folder import read_certificate, read_scene, write_certificate, write_scene
from panopath.formats.geo import GeoPath, LocalFrame, read_geojson, read_gpx, write_geojson, write_gpx
from panopath.formats.models import Reconstruction, write_models
from panopath.formats.nerfstudio import read_transforms, write_nerfstudio
from panopath.formats.positions import Truth, read_truth

__all__ = [
    "CropOptions",
    "Crops",
    "Database",
    "GeoPath",
    "LocalFrame",
    "Reconstruction",
    "Truth",
    "point_colours",
    "read_certificate",
    "read_control",
    "read_database",
    "read_geojson",
    "read_gpx",
    "read_problem",
    "read_scene",
    "read_tracks",
    "read_transforms",
    "read_truth",
    "write_certificate",
    "write_crops",
    "write_geojson",
    "write_gpx",
    "write_models",
    "write_nerfstudio",
    "write_scene",
    "write_tracks",
]
