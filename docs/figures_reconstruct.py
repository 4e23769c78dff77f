"""Pictures of ``panopath reconstruct``: the demo's walk, and its report as headless Chromium shows it.

``python -m docs.figures_reconstruct`` draws the pictures of README and docs/reconstruct.md.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from panopath.errors import MissingExtraError
from panopath.images import encoded, read_image

_OUT = Path("docs/img/reconstruct")
#: The top of the page: verdict, numbers, maps, thumbnails.
_WIDTH, _HEIGHT = 1180, 1180


def main() -> None:
    """Run the demo and take its report's picture."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        raise MissingExtraError("the report's picture needs Chromium, which is not installed")
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary) / "walk"
        subprocess.run([sys.executable, "-m", "panopath.cli", "demo", "-o", str(out)], check=True)
        shot = Path(temporary) / "report.png"
        flags = ["--headless=new", "--no-sandbox", "--hide-scrollbars", "--virtual-time-budget=5000"]
        size = f"--window-size={_WIDTH},{_HEIGHT}"
        page = (out / "report.html").as_uri()
        subprocess.run([browser, *flags, size, f"--screenshot={shot}", page], check=True, capture_output=True)
        _OUT.mkdir(parents=True, exist_ok=True)
        (_OUT / "report.jpg").write_bytes(encoded(read_image(shot), ".jpg", 85))
    print(f"wrote {_OUT / 'report.jpg'}")


if __name__ == "__main__":
    main()
