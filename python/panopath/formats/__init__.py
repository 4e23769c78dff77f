"""Files in and out: one file a format. :func:`read_tracks` recognises a file by what is in it."""

from panopath.formats.csv import read_control, write_tracks
from panopath.formats.database import Database, read_database
from panopath.formats.detect import read_problem, read_tracks
from panopath.formats.folder import read_certificate, read_scene, write_certificate, write_scene
from panopath.formats.models import Reconstruction, write_models
from panopath.formats.positions import Truth, read_truth

__all__ = [
    "Database",
    "Reconstruction",
    "Truth",
    "read_certificate",
    "read_control",
    "read_database",
    "read_problem",
    "read_scene",
    "read_tracks",
    "read_truth",
    "write_certificate",
    "write_models",
    "write_scene",
    "write_tracks",
]
