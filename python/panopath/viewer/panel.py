"""The panel beside the scene: what is certain, what is shown, and how."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import Any, get_args

import numpy as np

from panopath.movers import at_rest
from panopath.viewer.layers import Colouring, Drawing, Ellipsoids, Layer, Points

_BADGES = {"determined": "#2c964a", "weak": "#c77d0a", "undetermined": "#c8282d"}
#: Notes that are shown.
_MOST_NOTES = 3
_LEGEND = {
    "pictures": "as the panoramas show them",
    "parts": "a colour a part",
    "error": "blue small, red large",
    "track length": "blue many views, red two",
}


def verdict_html(drawing: Drawing, notes: Sequence[str] = ()) -> str:
    """Tell what is certain of the scene. Names are other people's text: all of it is escaped."""
    content = drawing.content
    summary, certificate = content.scene.summary, content.certificate
    lines = []
    if certificate is not None:
        verdict = str(certificate.get("verdict", "?"))
        colour = _BADGES.get(verdict, "#777777")
        lines.append(
            f"<span style='background:{colour};color:white;border-radius:4px;padding:1px 8px'>{escape(verdict)}</span>"
        )
        _, _, sentence = str(certificate.get("sentence", "")).partition(":")
        lines.append(escape(sentence.strip()))
        found = certificate.get("consistency") or {}
        if not found.get("passed", True):
            lines += [f"<b>contradicted:</b> {escape(str(reason))}" for reason in found.get("reasons", [])]
        lines += [escape(str(cause.get("sentence", ""))) for cause in certificate.get("causes", [])[:4]]
    else:
        lines.append("No certificate: <code>panopath check FOLDER</code> judges the scene.")
    still = at_rest(content.scene)
    solved = [int(np.isfinite(place).all(axis=1).sum()) for place in (still.centers, still.points)]
    numbers = f"{solved[0]:,} of {len(content.scene.centers):,} views, "
    numbers += f"{solved[1]:,} of {len(content.scene.points):,} points"
    if np.isfinite(summary.sigma_rad):
        numbers += f", noise {np.degrees(summary.sigma_rad):.2g} degrees"
    lines.append(numbers)
    lines += [escape(note) for note in (*content.notes, *notes)]
    return _block(lines)


def _block(lines: list[str]) -> str:
    text = "".join(f"<div style='margin:0.35em 0'>{line}</div>" for line in lines if line)
    return f"<div style='padding:0 1em;font-size:0.85em;line-height:1.35;overflow-wrap:anywhere'>{text}</div>"


class Panel:
    """The elements that all browsers share."""

    def __init__(self, drawing: Drawing, enter: Callable[[Any, int], None]) -> None:
        self._drawing, self._enter = drawing, enter
        self._gui = drawing.server.gui
        self._notes: list[str] = []
        self._verdict = self._gui.add_html(verdict_html(drawing))

    def tell(self, note: str) -> None:
        """Add what a person should know; of many such things the first few."""
        self._notes.append(note)
        if len(self._notes) <= _MOST_NOTES:
            self._verdict.content = verdict_html(self._drawing, self._notes)

    def time(self, layers: list[Layer]) -> None:
        """Add the slider over the views, and the button that enters one."""
        drawing = self._drawing
        count = len(drawing.order)
        with self._gui.add_folder("Time"):
            told = self._gui.add_html(self._moment(count - 1))
            slider = self._gui.add_slider("Up to view", 0, max(count - 1, 1), 1, count - 1, disabled=count < 2)
            has_images = any(path is not None for path in drawing.content.images)
            button = self._gui.add_button("Enter this panorama", visible=has_images and drawing.content.scene.d == 3)

        def moved(_: Any) -> None:
            last = min(int(slider.value), count - 1)
            told.content = self._moment(last)
            for layer in layers:
                layer.show_until(last)

        slider.on_update(moved)
        button.on_click(lambda event: self._enter(event.client, int(drawing.order[min(int(slider.value), count - 1)])))

    def _moment(self, last: int) -> str:
        scene, view = self._drawing.content.scene, int(self._drawing.order[last])
        text = escape(str(scene.view_labels()[view]))
        if scene.tracks is not None and scene.tracks.time_s is not None and np.isfinite(scene.tracks.time_s[view]):
            text += f" at {scene.tracks.time_s[view]:.2f} s"
        return _block([f"{last + 1} of {len(self._drawing.order)}: {text}"])

    def points(self, points: Points) -> None:
        """Colour and size of the points, and how many are shown."""
        with self._gui.add_folder("Points"):
            told = self._gui.add_html("")
            choice = self._gui.add_dropdown("Colour", points.choices, initial_value=points.choices[0])
            size = self._gui.add_slider("Size", 0.002, 0.1, 0.002, round(points.size, 3))

        def coloured(_: Any = None) -> None:
            chosen: Colouring = choice.value
            number = (
                f"{points.total:,} points"
                if points.count == points.total
                else (f"{points.count:,} of {points.total:,} points, evenly chosen, lest the view stutter")
            )
            told.content = _block([f"{number}; {_LEGEND[chosen]}"])

        def recoloured(_: Any) -> None:
            if choice.value in get_args(Colouring):
                points.colour(choice.value)
                coloured()

        coloured()
        choice.on_update(recoloured)
        size.on_update(lambda _: points.resize(float(size.value)))

    def layers(self, named: dict[str, tuple[Layer, bool]]) -> None:
        """Add a box a layer."""
        with self._gui.add_folder("Show"):
            for label, (layer, shown) in named.items():
                box = self._gui.add_checkbox(label, shown)
                box.on_update(lambda _, box=box, layer=layer: layer.show(bool(box.value)))

    def uncertainty(self, layer: Ellipsoids) -> None:
        """Ellipsoids and their size."""
        with self._gui.add_folder("Uncertainty"):
            box = self._gui.add_checkbox("Ellipsoids", False)
            size = self._gui.add_slider("Enlarged 10^", 0.0, 6.0, 0.1, 0.0, visible=False)
            told = self._gui.add_html("")

        def asked(_: Any) -> None:
            first = not layer.note and bool(box.value)
            if first:
                told.content = _block(["working ..."])
            layer.show(bool(box.value))
            if first:
                size.value = round(float(np.log10(layer.factor)), 1)
            size.visible = bool(box.value) and layer.note.startswith("One")
            self._told_size(told, layer)

        def resized(_: Any) -> None:
            layer.enlarge(10.0 ** float(size.value))
            self._told_size(told, layer)

        box.on_update(asked)
        size.on_update(resized)

    @staticmethod
    def _told_size(told: Any, layer: Ellipsoids) -> None:
        size = f"{layer.factor:,.0f} times. " if layer.note.startswith("One") else ""
        told.content = _block([size + escape(layer.note)])

    def parts(self, frames: list[Any], moved: Callable[[bool], None]) -> None:
        """Add a box a part, and one for whether they stand apart."""
        drawing = self._drawing
        if len(drawing.parts) < 2:
            return
        with self._gui.add_folder("Parts"):
            self._gui.add_html(
                _block(
                    [
                        "Parts share no scale; where they stand to one another means nothing unless both were "
                        "fitted to known positions."
                    ]
                )
            )
            apart = self._gui.add_checkbox("Side by side", True)
            apart.on_update(lambda _: moved(bool(apart.value)))
            for part, frame in zip(drawing.parts, frames, strict=True):
                r, g, b = part.colour
                self._gui.add_html(
                    f"<div style='padding:0 1em'><span style='color:rgb({r},{g},{b})'>&#9632;</span></div>"
                )
                box = self._gui.add_checkbox(
                    f"{part.name}: {len(part.views):,} views, {len(part.points):,} points", True
                )
                box.on_update(lambda _, box=box, frame=frame: setattr(frame, "visible", bool(box.value)))
