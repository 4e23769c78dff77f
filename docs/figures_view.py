"""Pictures of the viewer: a rendered walk is solved, written, served, and looked at with headless Chromium.

``python -m docs.figures_view`` draws the pictures of docs/view.md; the tests use its parts.
"""

from __future__ import annotations

import base64
import contextlib
import importlib
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import panopath as pp
from panopath.cameras import equirectangular_from_bearings
from panopath.formats import point_colours
from panopath.images import encoded
from panopath.viewer import Viewer, view
from panopath.walk import Walk, render_walk

Float = npt.NDArray[np.float64]

SIGMA_RAD = np.radians(0.05)
_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--enable-unsafe-swiftshader",
    "--use-angle=swiftshader",
    "--remote-debugging-port=0",
    "--no-first-run",
    "--hide-scrollbars",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-proxy-server",
)
_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")


def main() -> None:
    folder = Path(__file__).parent / "img" / "view"
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as place:
        scene = write_walk(Path(place) / "walk", n_frames=240, every=10, width_px=2048, n_points=9000)
        with opened(scene) as (viewer, page):
            draw_walk(viewer, page, folder)
        parts = write_parts(Path(place) / "parts")
        with opened(parts) as (_, page):
            save(page, folder / "parts.jpg")
    for picture in sorted(folder.glob("*.jpg")):
        print(picture.name, f"{picture.stat().st_size / 1000:.0f} kB")


def draw_walk(viewer: Viewer, page: Page, folder: Path) -> None:
    viewer.pictures.wait()
    save(page, folder / "scene.jpg")
    client = next(iter(viewer.server.get_clients().values()))
    viewer.enter(client, int(viewer.drawing.order[8]))
    save(page, folder / "inside.jpg")
    viewer.visit(client).leave()
    page.click_text("Ellipsoids")
    page.wait_for("document.body.innerText.includes('One standard deviation')")
    save(page, folder / "uncertainty.jpg")


def save(page: Page, path: Path) -> None:
    time.sleep(2.0)
    # the browser's remark that it draws without a graphics chip
    page.evaluate("document.querySelectorAll('.mantine-Notification-closeButton').forEach((b) => b.click())")
    time.sleep(1.0)
    path.write_bytes(page.screenshot("jpeg"))


def write_walk(
    out: Path, *, n_frames: int, every: int, width_px: int, n_points: int, rotation: Any = "sway", seed: int = 3
) -> Path:
    """Film a walk, measure points of the street in its keyframes, solve, and write all that ``reconstruct`` writes."""
    walk = render_walk(width_px=width_px, n_frames=n_frames, rotation=rotation, seed=seed)
    keyframes = list(range(0, len(walk), every))
    tracks = measured(walk, keyframes, n_points, seed)
    poses = walk.truth.cam_from_world[keyframes]
    scene = pp.solve_positions(tracks, poses)
    pictures = [walk.frame(k) for k in keyframes]

    def add_pictures(folder: Path) -> None:
        (folder / "images").mkdir()
        for name, picture in zip(tracks.view_names or (), pictures, strict=True):
            (folder / "images" / name).write_bytes(encoded(picture, ".jpg", 90))

    colours = point_colours(scene, lambda view: pictures[view])
    certificate = pp.certify(tracks, scene, pp.CertifyOptions(orientation="known"))
    return pp.write_scene(scene, out, certificate=certificate, colours=colours, extra=add_pictures)


def measured(walk: Walk, keyframes: list[int], n_points: int, seed: int) -> pp.Tracks:
    """Measure points of the street in the keyframes, with noise; a point is seen where nothing stands before it."""
    rng = np.random.default_rng(seed)
    ranges = [walk.ranges(k) for k in keyframes]
    centers, poses = walk.truth.centers[keyframes], walk.truth.cam_from_world[keyframes]
    points = []
    for center, pose, far in zip(centers, poses, ranges, strict=True):
        bearing = rng.normal(size=(4 * n_points // len(keyframes) + 4, 3))
        bearing /= np.linalg.norm(bearing, axis=1, keepdims=True)
        distance = sampled(far, bearing)
        near = np.isfinite(distance) & (distance < 40.0)
        points.append(center + distance[near, None] * bearing[near] @ pose)
    place = np.concatenate(points)
    place = place[np.sort(rng.permutation(len(place))[:n_points])]
    view, track, bearings = [], [], []
    for k, (center, pose, far) in enumerate(zip(centers, poses, ranges, strict=True)):
        ray = (place - center) @ pose.T
        distance = np.linalg.norm(ray, axis=1)
        ray /= distance[:, None]
        seen = np.flatnonzero(np.abs(sampled(far, ray) - distance) < 0.05 * distance)
        noisy = ray[seen] + rng.normal(0.0, SIGMA_RAD, (len(seen), 3))
        view.append(np.full(len(seen), k))
        track.append(seen)
        bearings.append(noisy / np.linalg.norm(noisy, axis=1, keepdims=True))
    return pp.Tracks.from_arrays(
        np.concatenate(view),
        np.concatenate(track),
        np.concatenate(bearings),
        n_views=len(keyframes),
        n_tracks=len(place),
        sigma_rad=SIGMA_RAD,
        time_s=walk.truth.time_s[keyframes],
        view_names=[f"frame_{k:05d}.jpg" for k in keyframes],
    )


def sampled(ranges: npt.NDArray[np.float32], bearing: Float) -> Float:
    """Distance at the pixel that each bearing falls in."""
    height, width = ranges.shape
    pixel = np.floor(equirectangular_from_bearings(bearing, width, height)).astype(int)
    found: Float = ranges[np.clip(pixel[:, 1], 0, height - 1), pixel[:, 0] % width].astype(np.float64)
    return found


def write_parts(out: Path) -> Path:
    """Three walks that see nothing in common."""
    worlds = [
        pp.simulate(name, n_views=n, n_points=m, noise_rad=5e-4, seed=k)
        for k, (name, n, m) in enumerate((("street", 60, 900), ("corridor", 30, 500), ("room", 15, 250)))
    ]
    first_view = np.cumsum([0] + [world.tracks.n_views for world in worlds])
    first_track = np.cumsum([0] + [world.tracks.n_tracks for world in worlds])
    tracks = pp.Tracks.from_arrays(
        np.concatenate([world.tracks.view + a for world, a in zip(worlds, first_view, strict=False)]),
        np.concatenate([world.tracks.track + a for world, a in zip(worlds, first_track, strict=False)]),
        np.concatenate([world.tracks.bearing for world in worlds]),
    )
    scene = pp.solve_positions(tracks)
    return pp.write_scene(scene, out, certificate=pp.certify(tracks, scene, pp.CertifyOptions(orientation="known")))


@contextlib.contextmanager
def opened(folder: Path, width: int = 1280, height: int = 800) -> Iterator[tuple[Viewer, Page]]:
    """Serve a folder and open the page; both are closed at the end."""
    with view(folder, port=0, open_browser=False, block=False) as viewer, Page.open(width, height) as page:
        page.go(viewer.url)
        deadline = time.monotonic() + 60.0
        while not viewer.server.get_clients():
            if time.monotonic() > deadline:
                raise TimeoutError("the page did not connect")
            time.sleep(0.1)
        yield viewer, page


def find_chromium() -> str | None:
    """Path of a Chromium, None where there is none."""
    return next((path for path in map(shutil.which, _NAMES) if path is not None), None)


class Page:
    """A page of a headless Chromium, driven by its DevTools protocol."""

    def __init__(self, socket: Any) -> None:
        self._socket, self._count = socket, 0
        #: Errors that the page reported, and addresses that it asked for.
        self.errors: list[str] = []
        self.asked: list[str] = []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    @classmethod
    @contextlib.contextmanager
    def open(cls, width: int, height: int) -> Iterator[Page]:
        """Start a browser; it ends with the context."""
        path = find_chromium()
        if path is None:
            raise FileNotFoundError("there is no Chromium")
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
            command = [path, *_FLAGS, f"--user-data-dir={profile}", f"--window-size={width},{height}", "about:blank"]
            browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            try:
                with cls._connected(Path(profile), browser) as socket:
                    page = cls(socket)
                    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
                    page.call("Emulation.setDeviceMetricsOverride", **size)
                    yield page
            finally:
                browser.terminate()
                try:
                    browser.wait(10.0)
                except subprocess.TimeoutExpired:
                    browser.kill()
                    browser.wait()

    @staticmethod
    @contextlib.contextmanager
    def _connected(profile: Path, browser: subprocess.Popen[bytes]) -> Iterator[Any]:
        connect = importlib.import_module("websockets.sync.client").connect
        told = profile / "DevToolsActivePort"
        deadline = time.monotonic() + 60.0
        while not (told.exists() and told.read_text().count("\n")):
            if browser.poll() is not None or time.monotonic() > deadline:
                raise TimeoutError("Chromium did not start")
            time.sleep(0.1)
        port, path = told.read_text().splitlines()[:2]
        with connect(f"ws://127.0.0.1:{port}{path}", max_size=None, proxy=None) as socket:
            socket.send(json.dumps({"id": 1, "method": "Target.getTargets"}))
            answer = json.loads(socket.recv())
            target = next(t["targetId"] for t in answer["result"]["targetInfos"] if t["type"] == "page")
        with connect(f"ws://127.0.0.1:{port}/devtools/page/{target}", max_size=None, proxy=None) as socket:
            yield socket

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Ask the browser for something; events that come before the answer are noted."""
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=120.0))
            if message.get("id") == self._count:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                found: dict[str, Any] = message["result"]
                return found
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        method, given = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(given["exceptionDetails"])[:400])
        elif method == "Runtime.consoleAPICalled" and given["type"] in ("error", "assert"):
            self.errors.append(" ".join(str(a.get("value", a.get("description"))) for a in given["args"])[:400])
        elif method == "Log.entryAdded" and given["entry"]["level"] == "error":
            self.errors.append(f"{given['entry']['text']} {given['entry'].get('url', '')}"[:400])
        elif method == "Network.requestWillBeSent":
            self.asked.append(given["request"]["url"][:120])

    def go(self, url: str) -> None:
        """Open an address."""
        self.call("Page.navigate", url=url)

    def evaluate(self, script: str) -> Any:
        """Value of an expression in the page."""
        return self.call("Runtime.evaluate", expression=script, returnByValue=True)["result"].get("value")

    def wait_for(self, condition: str, timeout_s: float = 60.0) -> None:
        """Wait until an expression is true."""
        deadline = time.monotonic() + timeout_s
        while not self.evaluate(condition):
            if time.monotonic() > deadline:
                raise TimeoutError(condition)
            time.sleep(0.1)

    def click(self, x: float, y: float) -> None:
        """Press and release the left button at a place of the page."""
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            button = "none" if kind == "mouseMoved" else "left"
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, clickCount=1)
            time.sleep(0.1)

    def click_text(self, text: str) -> None:
        """Click on the innermost element that says just this, or on the box beside it."""
        script = f"""(() => {{
          const found = [...document.querySelectorAll("label, button, span, div")]
            .filter((e) => e.textContent.trim() === {json.dumps(text)} && e.getBoundingClientRect().width > 0).pop();
          if (!found) return null;
          found.scrollIntoView({{ block: "center" }});
          let row = found;
          for (let k = 0; k < 6 && row && !row.querySelector("input"); k++) row = row.parentElement;
          const input = found.closest("button") ? null : row && row.querySelector("input[type=checkbox]");
          const box = (input || found).getBoundingClientRect();
          return [box.left + box.width / 2, box.top + box.height / 2];
        }})()"""
        place, before = self.evaluate(script), None
        deadline = time.monotonic() + 30.0
        # the panel may still be rearranging itself
        while place is None or place != before:
            if time.monotonic() > deadline:
                raise LookupError(f"the page does not say {text!r}, or does not come to rest")
            time.sleep(0.3)
            place, before = self.evaluate(script), place
        self.click(*place)

    def screenshot(self, kind: str = "png") -> bytes:
        """Picture of what is seen, as a file."""
        options: dict[str, Any] = {"format": kind} if kind == "png" else {"format": kind, "quality": 82}
        return base64.b64decode(self.call("Page.captureScreenshot", **options)["data"])


if __name__ == "__main__":
    main()
