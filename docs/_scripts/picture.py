"""The picture of docs/page.md: `karolos ui` over the reference runs, in headless Chromium.

python docs/_scripts/picture.py
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from queue import Queue

from PIL import Image

from karolos.report.ui.server import serve
from karolos.store import Store, reindex

ROOT = Path(__file__).parents[2]
PICTURE = ROOT / "docs" / "page.png"
SIZE = "1200,760"


def main() -> None:
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        sys.exit("there is no Chromium on this machine")
    with tempfile.TemporaryDirectory() as folder:
        store = Store(f"sqlite:///{folder}/karolos.sqlite")
        reindex(store, ROOT / "runs" / "reference")
        address: Queue[str] = Queue()
        options = {"host": "127.0.0.1", "port": 0, "ready": address.put}
        threading.Thread(target=serve, args=(Path(folder), store), kwargs=options, daemon=True).start()
        flags = (
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            f"--user-data-dir={folder}/profile",
        )
        command = [chromium, *flags, f"--window-size={SIZE}", f"--screenshot={PICTURE}", address.get(timeout=60)]
        subprocess.run(command, check=True, capture_output=True, timeout=120)
    Image.open(PICTURE).convert("RGB").quantize(64).save(PICTURE, optimize=True)
    print(f"{PICTURE.name}: {PICTURE.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
