"""Looks at the built site in headless Chromium, at the width of a phone. Exit code 1 if something is wrong.

python docs/_scripts/browse.py   after `make -C docs html`

Each page must load without errors and without a missing file, hold text, show pictures that are not empty, and not
scroll sideways. The search must find "prioritised". A page with all these faults shows that the checks can fail.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

SITE = Path(__file__).parents[1] / "_build" / "html"
PICTURES = os.environ.get("KAROLOS_PICTURES")
"""A folder in which pictures of some pages are left; none are taken without it."""
WIDTH, SECONDS = 390, 120
SEARCHED = "prioritised"
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", "--enable-logging=stderr", "--v=0"),
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",  # no page may need the network
)
FAULTY = f"""<!doctype html><title>faulty</title><p style="width:{WIDTH + 100}px">x</p>
<script>throw new Error("fault")</script>
<img src="data:image/gif;base64,R0lGODlhAQABAIAAAAAAAP///yH5BAEAAAAALAAAAAABAAEAAAIBRAA7"><img src="/missing.png">"""
LOOK = """<!doctype html><iframe id="frame" width="WIDTH" height="800"></iframe><script>
const frame = document.getElementById("frame"), found = {};
const pause = milliseconds => new Promise(done => setTimeout(done, milliseconds));
const open = url => new Promise(done => { frame.onload = done; frame.src = url; });
function isEmpty(image) {
  if (!image.complete || !image.naturalWidth) return true;
  const canvas = document.createElement("canvas"), pen = canvas.getContext("2d");
  canvas.width = canvas.height = 32;
  pen.drawImage(image, 0, 0, 32, 32);
  const values = pen.getImageData(0, 0, 32, 32).data;
  return values.every((value, place) => value === values[place % 4]);
}
async function look() {
  for (const url of PAGES) {
    await open(url);
    const page = frame.contentDocument, body = page.documentElement, problems = [];
    if (page.body.innerText.length < 200) problems.push("it holds hardly any text");
    if (body.scrollWidth > frame.contentWindow.innerWidth) problems.push(`it is ${body.scrollWidth} pixels wide`);
    for (const image of page.images)
      if (image.offsetParent && isEmpty(image)) problems.push(`an empty picture: ${image.getAttribute("src")}`);
    if (problems.length) found[url] = problems;
  }
  await open("/search.html?q=SEARCHED");
  let results = [];
  for (let turn = 0; turn < 100 && !results.length; turn++) {
    await pause(100);
    results = [...frame.contentDocument.querySelectorAll("#search-results li a")].map(link => link.innerText);
  }
  await fetch("/done", { method: "POST", body: JSON.stringify({ problems: found, results }) });
}
look();
</script>"""


class Server(ThreadingHTTPServer):
    """Serves the site and the page that looks at it; keeps the answer and what was missing."""

    def __init__(self, pages: list[str]) -> None:
        super().__init__(("127.0.0.1", 0), partial(Handler, directory=str(SITE)))
        look = LOOK.replace("WIDTH", str(WIDTH)).replace("PAGES", json.dumps(pages)).replace("SEARCHED", SEARCHED)
        self.made = {"/look": look, "/faulty": FAULTY}
        self.missing: list[str] = []
        self.answer: dict[str, Any] = {}
        self.answered = threading.Event()


class Handler(SimpleHTTPRequestHandler):
    """Requests of the browser."""

    server: Server

    def do_GET(self) -> None:
        text = self.server.made.get(self.path)
        if text is None:
            super().do_GET()
            return
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(text.encode())

    def do_POST(self) -> None:
        self.server.answer = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.send_response(204)
        self.end_headers()
        self.server.answered.set()

    def log_request(self, code: object = "-", size: object = "-") -> None:  # noqa: ARG002
        """Nothing is written; files that are missing are kept."""
        if code == HTTPStatus.NOT_FOUND and self.path != "/favicon.ico":
            self.server.missing.append(self.path)

    def log_error(self, *args: object) -> None:
        """`log_request` is enough."""


def main() -> None:
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        sys.exit("there is no Chromium on this machine")
    pages = [f"/{path.relative_to(SITE).as_posix()}" for path in sorted(SITE.rglob("*.html"))]
    with Server(["/faulty", *pages]) as server, tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}/look"
        command = [chromium, *FLAGS, "--remote-debugging-port=0", f"--user-data-dir={profile}/look", url]
        browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        is_answered = server.answered.wait(SECONDS)
        browser.terminate()
        for page in ("index", "results", "generated/gallery/index") if PICTURES else ():
            picture = f"--screenshot={PICTURES}/site-{page.rpartition('/')[0].rpartition('/')[2] or page}.png"
            address = f"http://127.0.0.1:{server.server_port}/{page}.html"
            shot = [
                chromium,
                *FLAGS,
                f"--user-data-dir={profile}/pictures",
                "--window-size=1200,1400",
                picture,
                address,
            ]
            subprocess.run(shot, check=True, capture_output=True, timeout=60)
        console = [line for line in browser.communicate()[1].splitlines() if ":CONSOLE" in line]
        server.shutdown()
    if not is_answered:
        sys.exit(f"the browser did not look at all pages within {SECONDS} s")
    problems: dict[str, list[str]] = server.answer["problems"]
    expected = problems.pop("/faulty", [])
    noticed = (len(expected) == 4, server.missing[:1] == ["/missing.png"], any("fault" in line for line in console))
    wrong = [] if all(noticed) else [f"the faulty page was not noticed: {expected} {server.missing} {console}"]
    wrong += [f"{page}: {what}" for page, found in problems.items() for what in found]
    wrong += [f"missing: {path}" for path in server.missing if path != "/missing.png"]
    wrong += [line for line in console if "/faulty" not in line and "/missing.png" not in line]
    if not server.answer["results"]:
        wrong.append(f"the search does not find {SEARCHED!r}")
    print(f"{len(pages)} pages; {SEARCHED!r} is in: {', '.join(server.answer['results'])}")
    if wrong:
        sys.exit("\n".join(wrong))


if __name__ == "__main__":
    main()
