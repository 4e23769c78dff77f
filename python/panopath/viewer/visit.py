"""Standing in a panorama: each browser for itself flies to a view's centre, and its panorama lies all around.

Seen from the centre of its sphere a panorama looks the same at any radius. So the sphere is either larger than all the
rest, and points are drawn over the picture, or so small that nothing else is seen.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from html import escape
from typing import Any

import numpy as np

from panopath.errors import InputError
from panopath.model import Float
from panopath.viewer.glb import textured
from panopath.viewer.layers import Drawing, Pictures, add_panorama
from panopath.viewer.shapes import panorama_sphere

#: Widest panorama that is sent to a browser; what graphics chips hold without effort.
_MOST_PX = 4096
#: Radius of the sphere when points are drawn over the picture, and when not.
_FAR, _NEAR = 400.0, 0.05
#: How far the camera stays from the point about which it turns: looking round is turning about the centre.
_ARM = 0.004
_STEPS, _FLIGHT_S = 24, 0.7


class Visit:
    """What one browser does inside panoramas."""

    def __init__(self, drawing: Drawing, pictures: Pictures, client: Any) -> None:
        self._drawing, self._pictures, self._client = drawing, pictures, client
        self._lock = threading.Lock()
        self._sphere: Any = None
        self._hidden: list[Any] = []
        self._before: tuple[Float, Float, float, float, float, float] | None = None
        #: The view one stands in, None outside.
        self.view: int | None = None
        gui = client.gui
        # above all that browsers share
        self._told = gui.add_html("", visible=False, order=-9.0)
        self._buttons = [
            self._button("Leave the panorama", self.leave, -8.0),
            self._button("Next view", lambda: self.step(1), -7.0),
            self._button("Previous view", lambda: self.step(-1), -6.0),
        ]
        self._over = gui.add_checkbox("Scene over picture", True, visible=False, order=-5.0)
        self._over.on_update(lambda _: self._resize())
        self._fov = gui.add_slider("Field of view", 30, 110, 1, 75, visible=False, order=-4.0)
        self._fov.on_update(lambda _: self._zoom())

    def _button(self, label: str, action: Callable[[], None], order: float) -> Any:
        button = self._client.gui.add_button(label, visible=False, order=order)
        button.on_click(lambda _: action())
        return button

    def enter(self, view: int) -> None:
        """Fly to a view and stand in its panorama; where it has none, say so."""
        if not self._lock.acquire(blocking=False):
            return
        try:
            try:
                jpeg = self._drawing.content.panorama(view, _MOST_PX)
            except InputError as error:
                self._client.add_notification("No panorama", str(error), auto_close_seconds=6.0)
                return
            self._enter(view, jpeg)
        finally:
            self._lock.release()

    def _enter(self, view: int, jpeg: bytes) -> None:
        drawing, client = self._drawing, self._client
        if self._before is None:
            camera = client.camera
            self._before = (
                camera.position,
                camera.look_at,
                camera.fov,
                camera.near,
                camera.min_orbit_distance,
                camera.max_orbit_distance,
            )
            camera.min_orbit_distance = _ARM / 2
            camera.near = _ARM / 2
        part = drawing.parts[drawing.part_of(view)]
        offset = np.asarray(drawing.server.scene.get_handle_by_name(f"/parts/{drawing.part_of(view)}").position)
        center = part.shown(drawing.content.scene.centers[[view]])[0] + offset
        self._put_away()
        forward = self._forward(view)
        client.camera.max_orbit_distance = max(self._before[5], 1.0)
        self._fly(center, center + forward, np.radians(self._fov.value))
        self._sphere = add_panorama(drawing, client.scene, "/panorama", view, textured(panorama_sphere(), jpeg))
        self._sphere.position = center
        # spheres with pictures would bar the sight along the path; a node of the same name, for this browser only,
        # stands before the one that all share
        self._hidden = [
            client.scene.add_frame(self._pictures.name(other), show_axes=False, visible=False)
            for other in self._pictures.views
            if self._pictures.has(other)
        ]
        self.view = view
        self._resize()
        with client.atomic():
            client.camera.position = center - _ARM * forward
            client.camera.look_at = center
            client.camera.max_orbit_distance = _ARM
        self._tell(view)

    def leave(self) -> None:
        """Go back to where one was before."""
        with self._lock:
            if self._before is None:
                return
            self._put_away()
            position, look_at, fov, near, nearest, farthest = self._before
            self._client.camera.max_orbit_distance = farthest
            self._fly(position, look_at, fov)
            self._client.camera.near = near
            self._client.camera.min_orbit_distance = nearest
            self._before, self.view = None, None
            self._show(False)

    def draw_over(self, over: bool) -> None:
        """Draw the scene over the picture, or the picture alone."""
        self._over.value = over
        self._resize()

    def step(self, by: int) -> None:
        """Go on to the next view that has a panorama, or back to the one before."""
        if self.view is None:
            return
        order, images = self._drawing.order, self._drawing.content.images
        place = int(self._drawing.rank[self.view]) + by
        while 0 <= place < len(order):
            if images[order[place]] is not None:
                self.enter(int(order[place]))
                return
            place += by

    def _put_away(self) -> None:
        for node in (self._sphere, *self._hidden):
            if node is not None:
                node.remove()
        self._sphere, self._hidden = None, []

    def _forward(self, view: int) -> Float:
        """Give the camera's own forward direction, level; x where it looks up or down."""
        forward = np.array(self._drawing.content.scene.cam_from_world[view, 2], dtype=np.float64)
        forward[2] = 0.0
        length = float(np.linalg.norm(forward))
        return forward / length if length > 0.2 else np.array([1.0, 0.0, 0.0])

    def _fly(self, position: Float, look_at: Float, fov: float) -> None:
        camera = self._client.camera
        start, from_, wide = np.array(camera.position), np.array(camera.look_at), camera.fov
        for k in range(1, _STEPS + 1):
            along = (k / _STEPS) ** 2 * (3.0 - 2.0 * k / _STEPS)
            with self._client.atomic():
                camera.position = (1.0 - along) * start + along * position
                # the point looked at moves a little ahead, lest the two meet on the way
                camera.look_at = (1.0 - along) * from_ + along * look_at + 1e-6
                camera.fov = float((1.0 - along) * wide + along * fov)
            time.sleep(_FLIGHT_S / _STEPS)

    def _resize(self) -> None:
        sphere = self._sphere
        if sphere is not None:
            sphere.scale = _FAR if self._over.value else _NEAR

    def _zoom(self) -> None:
        if self.view is not None:
            self._client.camera.fov = float(np.radians(self._fov.value))

    def _tell(self, view: int) -> None:
        name = escape(str(self._drawing.content.scene.view_labels()[view]))
        self._told.content = f"<div style='padding:0 1em'>Inside <b>{name}</b></div>"
        self._show(True)

    def _show(self, shown: bool) -> None:
        for element in (self._told, *self._buttons, self._over, self._fov):
            element.visible = shown
