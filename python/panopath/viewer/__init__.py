"""A scene to walk about in, in a browser, served from this machine (extra ``view``).

:func:`view` reads a folder, serves it and opens the page. ``content`` says what a folder holds, ``shapes`` what it
looks like as arrays, ``layers`` what is drawn, ``visit`` how one stands in a panorama, ``panel`` what can be chosen.
"""

from panopath.viewer.server import Viewer, view

__all__ = ["Viewer", "view"]
