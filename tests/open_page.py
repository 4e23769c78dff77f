"""Open a page in headless Chromium (Qt WebEngine) and print what it found there as JSON; ``test_report_page`` runs it.

python open_page.py PAGE WIDTH [PICTURE]
"""

from __future__ import annotations

import importlib
import json
import os
import sys
from typing import Any

os.environ["QT_QPA_PLATFORM"] = "offscreen"
os.environ["QTWEBENGINE_CHROMIUM_FLAGS"] = "--no-sandbox --disable-gpu"

#: What a reader does: look, change the colours, come nearer, pick a view, take another part.
SCRIPT = """(async () => {
  const later = (ms) => new Promise((done) => setTimeout(done, ms));
  const paint = () => [...document.querySelectorAll("canvas")].map((canvas) => {
    const copy = Object.assign(document.createElement("canvas"), { width: canvas.width, height: canvas.height });
    const pen = copy.getContext("2d", { willReadFrequently: true });
    pen.drawImage(canvas, 0, 0);
    const data = pen.getImageData(0, 0, copy.width, copy.height).data;
    let painted = 0, sum = 0;
    for (let k = 0; k < data.length; k += 4) {
      if (data[k + 3]) { painted++; sum += k * (data[k] + 2 * data[k + 1]) % 65521; }
    }
    return [painted, sum];
  });
  const root = document.documentElement, found = { drawn: root.dataset.drawn || "no", before: paint() };
  found.overflow = root.scrollWidth - root.clientWidth;
  const click = async (which) => {
    const element = document.querySelector(which);
    if (element) { element.click(); await later(250); }
    return !!element;
  };
  found.coloured = await click("[data-colour=error]"); found.error = paint();
  await click("[data-zoom='1.5']"); found.nearer = paint();
  await click("[data-zoom='0']"); found.whole = paint();
  found.picked = await click(".strip button:nth-child(3)");
  found.pressed = document.querySelectorAll(".strip button[aria-pressed=true]").length; found.marked = paint();
  const part = document.getElementById("part");
  if (part) { part.value = "1"; part.dispatchEvent(new Event("change")); await later(250); found.other = paint(); }
  const canvas = document.querySelector("canvas");
  if (canvas) {
    const box = canvas.getBoundingClientRect();
    let tip = document.querySelector(".tip");
    for (let k = 0; k < 1600 && tip.hidden; k++) {
      canvas.dispatchEvent(new PointerEvent("pointermove", { pointerType: "mouse",
        clientX: box.left + box.width * ((k % 40) / 40), clientY: box.top + box.height * Math.floor(k / 40) / 40 }));
    }
    found.tip = tip.textContent;
    tip.hidden = true;
  }
  found.hostile = !!window.hostile;
  found.height = root.scrollHeight;
  document.title = "FOUND" + JSON.stringify(found);
})();"""


def main() -> None:
    page, width = sys.argv[1], int(sys.argv[2])
    qt: Any = importlib.import_module("PyQt6.QtCore")
    widgets: Any = importlib.import_module("PyQt6.QtWidgets")
    engine: Any = importlib.import_module("PyQt6.QtWebEngineWidgets")
    core: Any = importlib.import_module("PyQt6.QtWebEngineCore")
    app = widgets.QApplication(sys.argv[:1])
    view = engine.QWebEngineView()
    console: list[str] = []
    asked: list[str] = []

    class Page(core.QWebEnginePage):  # type: ignore[misc, name-defined, unused-ignore]
        def javaScriptConsoleMessage(self, _level: Any, message: str, line: int, _source: str) -> None:  # noqa: N802
            console.append(f"{line}: {message}")

    class Watch(core.QWebEngineUrlRequestInterceptor):  # type: ignore[misc, name-defined, unused-ignore]
        def interceptRequest(self, info: Any) -> None:  # noqa: N802
            asked.append(info.requestUrl().toString()[:80])

    shown, watch = Page(view), Watch()
    shown.profile().setUrlRequestInterceptor(watch)
    view.setPage(shown)
    view.resize(width, 900)

    def told(title: str) -> None:
        if title.startswith("FOUND"):
            found = json.loads(title[5:]) | {"console": console, "asked": [url for url in asked if url[:5] != "data:"]}
            print(json.dumps(found))
            view.resize(width, min(int(found["height"]), 8000))
            qt.QTimer.singleShot(1200 if len(sys.argv) > 3 else 0, finish)

    def finish() -> None:
        if len(sys.argv) > 3:
            view.grab().save(sys.argv[3])
        app.quit()

    view.titleChanged.connect(told)
    view.loadFinished.connect(lambda _: qt.QTimer.singleShot(600, lambda: shown.runJavaScript(SCRIPT)))
    view.load(qt.QUrl.fromLocalFile(page))
    view.show()
    qt.QTimer.singleShot(45_000, app.quit)
    app.exec()


if __name__ == "__main__":
    main()
