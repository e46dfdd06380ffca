"""A walk through `karolos ui` in headless Chromium, over a thousand runs: a page beside it types, clicks and looks."""

import json
import os
import subprocess
import threading
from dataclasses import replace
from queue import Queue
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Mount, Route
from support.browser import chromium, in_browser
from support.compared_runs import EVIL
from support.run_samples import SPEC, add_run, bare, new_run, result

from karolos.records.evaluation import Evaluation
from karolos.records.run_records import RunRecord
from karolos.report.ui.app import Application
from karolos.store import Store

PICTURES = os.environ.get("KAROLOS_PICTURES")
"""A folder in which pictures of the pages are left; none are taken without it."""
WALK = """<!doctype html><iframe id="frame" width="390" height="800"></iframe><script>
const frame = document.getElementById("frame"), steps = {}, times = {};
const page = () => frame.contentDocument, find = what => page().querySelector(what);
const all = what => [...page().querySelectorAll(what)], count = what => all(what).length;
const open = url => new Promise(done => { frame.onload = done; frame.src = url; });
const left = act => new Promise(done => { frame.onload = done; act(); });
async function until(holds) {
  for (let turn = 0; turn < 1500; turn++) {
    if (holds()) return true;
    await new Promise(done => setTimeout(done, 10));
  }
  return false;
}
const happen = (what, kind, name, more) =>
  what.dispatchEvent(new frame.contentWindow[kind](name, { bubbles: true, ...more }));
const press = key => happen(page().body, "KeyboardEvent", "keydown", { key });
function type(text) {
  find("#filter").value = text;
  happen(find("#filter"), "Event", "input");
}
const fits = () => page().documentElement.scrollWidth <= 390;
async function walk() {
  let start = performance.now();
  await open("/");
  times.first = performance.now() - start;
  steps["the list has a page of rows"] = count("[data-row]") === 50 && fits();
  press("/");
  steps["/ goes to the filter"] = page().activeElement === find("#filter");
  start = performance.now();
  type("name=exp7");
  steps["the filter is applied while one types"] = await until(() => count("[data-row]") === 1);
  times.filter = performance.now() - start;
  type("nme=exp7");
  steps["a wrong filter is explained"] = await until(() => find("#list .problem")?.innerText.includes("mean name?"));
  type("");
  await until(() => count("[data-row]") === 50);
  find("#filter").blur();
  for (const key of "jjjxjx") press(key);
  steps["j and x choose"] = find("[data-compare]").innerText === "Compare 2";
  await fetch("/add", { method: "POST" });
  steps["a new run appears by itself"] = await until(() => find("[data-row]").innerText.includes("brand_new"));
  steps["what was chosen stays chosen"] = await until(() => find("[data-compare]").innerText === "Compare 2");
  steps["a name is text"] = frame.contentWindow.ran === undefined && page().body.innerText.includes("<script>");
  await left(() => find("[data-compare]").click());
  steps["the comparison draws its figures"] = count("figure svg") >= 3 && fits();
  await open("/?where=name=brand_new");
  await left(() => find("a.seed-link").click());
  const shown = find("h1").innerText.startsWith("brand_new-s0") && count("video") === 1;
  steps["a seed leads to its run and its film"] = shown && fits();
  find("input[name=add]").value = "good";
  await left(() => find("input[name=add]").form.querySelector("button").click());
  steps["a tag is added"] = find(".tag")?.innerText.startsWith("good");
  await left(() => find("#live tbody th a").click());
  steps["a test is shown episode by episode"] = count("tr[id]") === 20 && count(".failure") === 1 && fits();
  await open("/?where=name~going");
  await left(() => find("[data-row] th a").click());
  steps["a long name fits"] = fits();
  await open("/?where=name~going");
  await left(() => find("a.seed-link").click());
  await fetch("/test", { method: "POST" });
  steps["a live run shows its new test"] = await until(() => find("#tests").innerText.includes("2,000"));
  await fetch("/remove", { method: "POST" });
  steps["a page of a removed run says so"] = await until(() => find("#notice").innerText.includes("there is no run"));
}
const tell = error => { if (error) steps[`${error} after ${Object.keys(steps).pop()}`] = false; };
walk().catch(tell).then(() => fetch("/done", { method: "POST", body: JSON.stringify({ steps, times }) }));
</script>"""


def thousand_runs(store: Store) -> None:
    """200 experiments of five seeds, with ten tests each and no folders."""
    first = bare(store, "first")
    tests = tuple(Evaluation(k * 1000, k * 10.0, 20, 2 * k, 2 * k, 0, -1.0) for k in range(1, 11))
    records = []
    for place in range(1000):
        name, created = f"exp{place // 5}", f"2026-01-01T00:{place // 60:02}:{place % 60:02}.000000Z"
        own = {"run": f"{name}-s{place % 5}", "experiment": name, "seed": place % 5, "name": name, "created": created}
        records.append(RunRecord(replace(first, success_end=1.0, episodes=20, **own), SPEC | {"name": name}, tests, {}))
    store.add_records(records)


def take_pictures(url: str, store: Store) -> None:
    """A list, a run, a comparison and a phone, to be looked at."""
    run = store.runs(name="brand_new")[0].run
    pages = {"list": "/", "run": f"/runs/{run}", "comparison": "/compare?e=exp1&e=exp2", "phone": "/"}
    for name, address in pages.items():
        size = "--window-size=500,900" if name == "phone" else "--window-size=1200,900"
        shot = chromium("--hide-scrollbars", size, f"--screenshot={PICTURES}/ui-{name}.png", url + address)
        subprocess.run(shot, check=True, capture_output=True, timeout=60)


@in_browser
def test_walk_through_the_pages_in_a_browser(tmp_path):
    store, answers = Store(Store.default_url(tmp_path)), Queue[dict[str, Any]]()
    thousand_runs(store)
    bare(
        store, "evil", experiment="evil", name="<script>parent.ran = window.ran = 1</script>" + EVIL, created="2026-02"
    )

    def add(_: Request) -> Response:
        (tmp_path / add_run(tmp_path, 0, name="brand_new") / "play.mp4").touch()
        return Response()

    going = new_run(tmp_path, "going" + "x" * 90, experiment="going")
    going.add_test(result(1000, 9))
    going.set_state("running", steps=1000)
    store.add_records([going.record()])

    def test(_: Request) -> Response:
        going.add_test(result(2000, 19))
        going.set_state("running", steps=2000)
        return Response()

    def remove(_: Request) -> Response:
        store.remove_runs([going.id])
        return Response()

    async def done(request: Request) -> Response:
        answers.put(json.loads(await request.body()))
        return Response()

    own = [Route("/walk", lambda _: HTMLResponse(WALK)), Route("/add", add, methods=["POST"])]
    own += [Route("/test", test, methods=["POST"]), Route("/remove", remove, methods=["POST"])]
    routes = [*own, Route("/done", done, methods=["POST"]), Mount("/", Application(tmp_path, store).asgi())]
    server = uvicorn.Server(uvicorn.Config(Starlette(routes=routes), port=0, log_level="warning", lifespan="off"))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        thread.join(0.01)
    url = f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    browser = subprocess.Popen(
        chromium(f"--user-data-dir={tmp_path / 'profile'}", "--remote-debugging-port=0", f"{url}/walk"),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        answer = answers.get(timeout=100)
    finally:
        browser.terminate()
        browser.wait()
        if PICTURES:
            take_pictures(url, store)
        server.should_exit = True
        thread.join()
    assert [step for step, holds in answer["steps"].items() if not holds] == []
    assert len(answer["steps"]) == 15
    assert max(answer["times"].values()) < 3000  # ms, of which the filter waits 200; a tenth of it on a machine at rest
