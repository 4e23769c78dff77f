"""From a video or a folder of pictures to a folder of answers: the whole job."""

from panopath.run.job import Reconstructed, reconstruct
from panopath.run.options import RunOptions
from panopath.run.place import Placed, camera_height, place_on_earth

__all__ = ["Placed", "Reconstructed", "RunOptions", "camera_height", "place_on_earth", "reconstruct"]
