"""The server: one port of this machine, viser behind it."""

from __future__ import annotations

import contextlib
import errno
import importlib
import io
import socket
import threading
import webbrowser
from os import PathLike
from types import TracebackType
from typing import Any

import numpy as np

from panopath.errors import InputError, MissingExtraError
from panopath.viewer.content import Content, read_content
from panopath.viewer.layers import Bodies, Drawing, Ellipsoids, Layer, Pictures, Points, Views, axes, path
from panopath.viewer.panel import Panel
from panopath.viewer.shapes import REACH, Part, across, parts_of
from panopath.viewer.visit import Visit

_IN_USE = "{host}, port {port}: is in use; choose another port, or 0 for a free one"


class Viewer:
    """A scene being served; close it, or use it in a ``with`` statement."""

    def __init__(self, content: Content, server: Any) -> None:
        #: What is shown.
        self.content = content
        #: The viser server, for what is added to the scene by others.
        self.server = server
        self._visits: dict[int, Visit] = {}
        self._visits_lock = threading.Lock()
        self._closed = threading.Event()
        parts = parts_of(content.scene, apart=True)
        self._draw(parts)

    def _draw(self, parts: list[Part]) -> None:
        server = self.server
        server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        server.scene.set_up_direction("+z")
        server.scene.configure_default_lights(cast_shadow=False)
        self.drawing = drawing = Drawing.of(server, self.content, parts)
        self._frames = [
            server.scene.add_frame(f"/parts/{k}", show_axes=False, position=part.offset) for k, part in enumerate(parts)
        ]
        self._aim(parts)
        self.points = points = Points(drawing)
        views, line, arms = Views(drawing, self.enter), path(drawing), axes(drawing)
        panel = Panel(drawing, self.enter)
        self.pictures = Pictures(drawing, self.enter, panel.tell)
        self.ellipsoids = Ellipsoids(drawing)
        arms.show(False)
        self.bodies = bodies = Bodies(drawing)
        self.layers: list[Layer] = [points, line, views, arms, bodies, self.pictures, self.ellipsoids]
        panel.time(self.layers)
        panel.points(points)
        shown: dict[str, tuple[Layer, bool]] = {
            "Points": (points, True),
            "Path": (line, True),
            "Views": (views, True),
            "Axes of cameras": (arms, False),
        }
        if bodies.total:
            of = f"{bodies.count:,} of " if bodies.count < bodies.total else ""
            shown[f"Bodies that move ({of}{bodies.total:,} tracks)"] = (bodies, True)
        if self.pictures.views:
            label = "Panoramas on spheres"
            if self.pictures.total > len(self.pictures.views):
                label += f" ({len(self.pictures.views)} of {self.pictures.total:,})"
            shown[label] = (self.pictures, True)
        panel.layers(shown)
        panel.uncertainty(self.ellipsoids)
        panel.parts(self._frames, self._set_apart)
        server.on_client_connect(self._join)
        server.on_client_disconnect(self._part_from)

    def _aim(self, parts: list[Part]) -> None:
        """Choose where the camera starts: beside the path and above, all parts in sight."""
        places = np.array([part.offset for part in parts])
        middle = (places.min(axis=0) + places.max(axis=0)) / 2.0
        width = REACH + 0.4 * float(np.ptp(places[:, 0]))
        right = across(self.drawing.centers(0)) if len(parts) == 1 else np.array([1.0, 0.0, 0.0])
        back = np.cross(right, (0.0, 0.0, 1.0))
        start = self.server.initial_camera
        start.position = middle + width * (-0.3 * right + 1.25 * back + np.array([0.0, 0.0, 0.9]))
        # the panel stands over the right of the page
        start.look_at = middle + 0.15 * width * right
        start.up = (0.0, 0.0, 1.0)

    @property
    def url(self) -> str:
        """Address of the page."""
        host = self.server.get_host()
        return f"http://{f'[{host}]' if ':' in host else host}:{self.server.get_port()}"

    def enter(self, client: Any, view: int) -> None:
        """Let a browser stand in the panorama of a view."""
        self.visit(client).enter(view)

    def visit(self, client: Any) -> Visit:
        """Give what a browser does inside panoramas."""
        with self._visits_lock:
            if client.client_id not in self._visits:
                self._visits[client.client_id] = Visit(self.drawing, self.pictures, client)
            return self._visits[client.client_id]

    def _join(self, client: Any) -> None:
        self.visit(client)

    def _part_from(self, client: Any) -> None:
        with self._visits_lock:
            self._visits.pop(client.client_id, None)

    def _set_apart(self, apart: bool) -> None:
        with self._visits_lock:
            visits = list(self._visits.values())
        for visit in visits:
            # a picture stays where it was put
            visit.leave()
        with self.server.atomic():
            for frame, part in zip(self._frames, parts_of(self.content.scene, apart=apart), strict=True):
                frame.position = part.offset

    def wait(self, timeout_s: float | None = None) -> None:
        """Wait until the viewer is closed, or somebody presses Ctrl+C."""
        with contextlib.suppress(KeyboardInterrupt):
            self._closed.wait(timeout_s)

    def close(self) -> None:
        """Stop serving; nothing of it runs on. Closing twice does no harm."""
        if not self._closed.is_set():
            self._closed.set()
            self.pictures.close()
            with contextlib.redirect_stdout(io.StringIO()):
                self.server.stop()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def view(
    folder: str | PathLike[str],
    *,
    port: int = 8080,
    host: str = "127.0.0.1",
    open_browser: bool = True,
    block: bool = True,
    images: str | PathLike[str] | None = None,
) -> Viewer:
    """Show a scene in a browser: points, path, panoramas to stand in, uncertainty, what is certain.

    Parameters
    ----------
    folder
        What a command or :func:`panopath.formats.write_scene` wrote, or a COLMAP model.
    port
        Port to serve at; 0 takes a free one.
    host
        Address to serve at. The default is seen by this machine alone; anybody who reaches another one may look.
    open_browser
        Whether to open the page.
    block
        Whether to serve until Ctrl+C; else the viewer is handed back at once, to be closed by the caller.
    images
        Folder of the panoramas, found by the names of the views; default: the one that ``run.json`` names, or else
        ``images`` in the folder.

    Returns
    -------
    Viewer
        With the address of the page; closed where ``block`` is set.

    Raises
    ------
    InputError
        Where the folder holds no scene, nothing of it is solved, or the port is in use.
    MissingExtraError
        Where viser is not installed.
    """
    if not 0 <= port <= 65_535:
        raise InputError(f"port is {port}, expected a number from 0 to 65535")
    viser = _viser()
    content = read_content(folder, images)
    _check_free(host, port)
    server = _started(viser, host, port)
    try:
        viewer = Viewer(content, server)
    except BaseException:
        server.stop()
        raise
    if open_browser:
        webbrowser.open(viewer.url)
    if block:
        try:
            viewer.wait()
        finally:
            viewer.close()
    return viewer


def _viser() -> Any:
    try:
        return importlib.import_module("viser")
    except ImportError:
        raise MissingExtraError('the viewer needs viser: install the extra with pip install "panopath[view]"') from None


def _check_free(host: str, port: int) -> None:
    """Viser takes the next port where one is in use; a person who named a port wants that one.

    Raises
    ------
    InputError
        Where nothing can be served at this address.
    """
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise InputError(_IN_USE.format(host=host, port=port)) from None
        raise InputError(f"{host}, port {port}: cannot be served at ({error.strerror})") from None


def _started(viser: Any, host: str, port: int) -> Any:
    # viser prints where it listens; what is said is for the caller to choose
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label="panopath", verbose=False)
    if port and server.get_port() != port:
        server.stop()
        raise InputError(_IN_USE.format(host=host, port=port))
    return server
