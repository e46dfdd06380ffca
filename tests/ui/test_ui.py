"""`karolos ui`: what its pages show and whom it refuses. In a browser it is walked through by test_ui_in_browser."""

import asyncio
import re
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path
from urllib.parse import parse_qs, quote, urlsplit

import pytest
from karolos_cli.ui import ui
from starlette.testclient import TestClient
from support.commands import call, karolos
from support.compared_runs import EVIL
from support.processes import wait_for
from support.run_samples import add_run, bare
from support.sweep_samples import some_trial, write_sweep
from typer import Typer

from karolos.errors import MachineError
from karolos.records import labels
from karolos.records.sweep_records import FOLDER
from karolos.report.ui.app import Application
from karolos.report.ui.rows import experiment_rows
from karolos.report.ui.server import guarded, serve
from karolos.store import Store
from karolos.store.experiments import find_experiments

HOST = "http://127.0.0.1:6789"
app = Typer()
app.command()(ui)


def client(runs: Path, listening: str = "127.0.0.1", token: str | None = None, **headers: str) -> TestClient:
    application = Application(runs, Store(Store.default_url(runs)))
    headers = {"origin": HOST} | headers
    return TestClient(guarded(application, listening, 6789, token), base_url=HOST, headers=headers)


def test_list_shows_experiments_and_takes_the_filters_of_runs_list(tmp_path):
    page = client(tmp_path)
    assert "karolos run panda_reach" in page.get("/").text  # what to do next
    for seed in (0, 1):
        add_run(tmp_path, seed)
    other = add_run(tmp_path, 0, rate=0.1, name="slide")
    text = page.get("/").text
    assert text.count("data-row") == 2
    assert f"/runs/{other}" in text
    assert "(0.950 to 0.950)" in text
    assert text.index("slide") < text.index(">reach<")  # the newest first
    for where, count in (
        ("agent.learning_rate>.01", 1),
        ("name=reach and seed=1", 1),
        ("folder~slide", 1),
        ("seed>4", 0),
    ):
        found = page.get("/", params={"where": where}).text
        assert (where, found.count("data-row")) == (where, count)
    wrong = page.get("/", params={"where": "state=finished and tsk=reach"}).text
    assert "filter, column 20: no run has &#39;tsk&#39;; did you mean task?" in wrong
    by_name = page.get("/", params={"order": "name"}).text
    assert by_name.index(">reach<") < by_name.index(">slide<")


def test_a_page_that_has_seen_everything_gets_nothing(tmp_path):
    add_run(tmp_path, 0)
    page = client(tmp_path)
    live = page.get("/").text.partition('data-live hx-get="')[2].partition('"')[0].replace("&amp;", "&")
    assert page.get(live).status_code == 204
    add_run(tmp_path, 1)
    assert page.get(live).text.count("seed-link") == 2


def test_run_page_shows_its_tests_and_settings_and_changes_its_labels(tmp_path):
    run, other = add_run(tmp_path, 0), add_run(tmp_path, 1)
    page = client(tmp_path)
    text = page.get(f"/runs/{run}").text
    for part in ("0.950", "agent.learning_rate", "1 of 20 episodes of the last test end without success", "<svg"):
        assert part in text
    episodes = page.get(f"/runs/{run}/tests/1000").text
    assert episodes.count('<tr id="e') == 20
    assert episodes.count('class="failure"') == 1
    page.post(f"/runs/{run}/labels", data={"add": "good", "all": "on"})
    page.post(f"/runs/{run}/labels", data={"note": "a\r\nb"})
    page.post(f"/runs/{other}/labels", data={"remove": "good"})
    assert labels.read(tmp_path / run) == labels.Labels(("good",), "a\nb")
    assert labels.read(tmp_path / other) == labels.Labels()
    assert page.get("/", params={"where": "tags=good"}).text.count("seed-link") == 1
    assert page.post(f"/runs/{run}/labels", data={"add": "x" * 300}).status_code == 400
    assert page.get("/runs/other").status_code == 404


def test_comparison_is_that_of_the_command(tmp_path):
    add_run(tmp_path, 0)
    add_run(tmp_path, 0, rate=0.1, name="slide")
    page = client(tmp_path)
    store = Store(Store.default_url(tmp_path))
    one, two = (store.runs(name=name)[0].experiment for name in ("reach", "slide"))
    text = page.get("/compare", params={"e": [one, two]}).text
    assert text.count("<figure") == 3  # no profile of seeds that are alike
    for part in ("reach, slide", "In numbers", "agent.learning_rate", 'id="show-1"', "/runs/slide-s0"):
        assert part in text
    assert page.get("/compare").status_code == 400


def test_names_notes_and_errors_are_text(tmp_path):
    store = Store(Store.default_url(tmp_path))
    bare(store, "evil-s0", name=EVIL, error=EVIL, note=EVIL, tags=(EVIL,), task=EVIL, state="failed")
    page = client(tmp_path)
    made_up = (f"/?where={quote(EVIL)}", f"/runs/{quote('<script>alert')}")
    for address in ("/", "/runs/evil-s0", "/compare?e=abc", *made_up):
        text = page.get(address).text
        assert "&lt;script&gt;" in text
        assert "<script>alert" not in text
        assert "<img" not in text


def test_damaged_folders_are_shown_as_such(tmp_path):
    run, other = add_run(tmp_path, 0), add_run(tmp_path, 1)
    (tmp_path / run / "run.json").write_text("{")
    (tmp_path / other / "tests.jsonl").write_text("nonsense\n")
    page = client(tmp_path)
    assert "run.json is damaged" in page.get(f"/runs/{run}").text
    assert "tests.jsonl:1: " in page.get(f"/runs/{other}").text
    assert "run.json is damaged" in page.get("/folders?check=1").text


def test_sweeps_suites_and_transfers_lead_to_what_they_wrote(tmp_path):
    page = client(tmp_path)
    for kind in ("sweep", "suite", "transfer"):
        assert f"<pre>karolos {kind}" in page.get(f"/{kind}s").text  # what to do next
    write_sweep(tmp_path, "x", [some_trial(0)])
    run = add_run(tmp_path, 0, name="x-t000")
    for file in (f"{FOLDER}/x/figures/history.svg", "suites/a b/report.html", "suites/a b/secret", "transfers/m/lock"):
        path = tmp_path / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"<body><h1>the report</h1><a href='../../{run}'>")
    listed = {
        "sweeps": ("1 of 3", "agent.learning_rate = 1", "/runs/sweeps/x/figures/history.svg"),
        "suites": ("/runs/suites/a%20b/report.html",),
        "transfers": ("m: no report yet",),
    }
    assert '<a href="/?trials=1">' in page.get("/").text  # the only run is a trial's
    for kind, parts in listed.items():
        text = page.get(f"/{kind}").text
        assert [part for part in parts if part not in text] == []
    report = page.get("/runs/suites/a%20b/report.html")
    assert "the report" in report.text
    assert '<a href="/suites">' in report.text  # a way back
    assert page.get(str(report.url.join(f"../../{run}"))).status_code == 200
    assert report.headers["content-security-policy"].startswith("sandbox")
    for hidden in (
        "a%20b/secret",
        "%2e%2e%2fx/report.html",
        "c/report.html",
        "%00/report.html",
        "%FF/x",
        "a" * 5000 + "/x",
    ):
        assert page.get(f"/runs/suites/{hidden}").status_code == 404


def test_an_unknown_address_is_a_page_with_a_way_back(tmp_path):
    page = client(tmp_path)
    for address, status in (("/nowhere", 404), ("/static/x.js", 404), ("/runs/a/b/<b>", 404), ("/runs/a/labels", 405)):
        answer = page.get(address)
        assert answer.status_code == status
        assert '<a href="/">' in answer.text
        assert "<b>" not in answer.text


@pytest.mark.parametrize(
    ("host", "named", "status"),
    [
        ("127.0.0.1", "localhost:6789", 200),
        ("127.0.0.1", "evil.example:6789", 421),
        ("127.0.0.1", "192.168.0.7:6789", 421),
        ("0.0.0.0", "192.168.0.7:6789", 200),
        ("0.0.0.0", "evil.example", 421),
        ("lab.example", "lab.example:6789", 200),
    ],
)
def test_a_request_names_this_machine(tmp_path, host, named, status):
    assert client(tmp_path, host, host=named).get("/").status_code == status


def test_token_is_asked_for_once(tmp_path):
    page = client(tmp_path, token="secret")
    for address in ("/", "/?token=secre", "/static/ui.js"):
        assert page.get(address).status_code == 403
    answer = page.get("/?token=secret&where=a%3D1", follow_redirects=False)
    assert answer.headers["location"] == f"{HOST}/?where=a%3D1"
    assert "HttpOnly" in answer.headers["set-cookie"]
    assert page.get("/").status_code == 200


@pytest.mark.parametrize(
    ("host", "token", "told"), [("127.0.0.1", "", ""), ("127.0.0.1", "a+b&c", r"a\+b&c"), ("0.0.0.0", "", ".{32}")]
)
def test_the_address_has_the_token_and_beyond_this_machine_there_is_always_one(
    tmp_path, monkeypatch, host, token, told
):
    monkeypatch.setattr("uvicorn.Server.run", lambda *_, **__: None)  # as if Ctrl-C came at once
    addresses: list[str] = []
    with Store(Store.default_url(tmp_path)) as store:
        serve(tmp_path, store, host=host, port=0, token=token, ready=addresses.append)
    (found,) = parse_qs(urlsplit(addresses[0]).query).get("token", [""])
    assert re.fullmatch(told, found)


@pytest.mark.parametrize("origin", ["", "null", "http://evil.example", "http://127.0.0.1:1"])
def test_forms_of_other_pages_are_refused(tmp_path, origin):
    run = add_run(tmp_path, 0)
    answer = client(tmp_path, origin=origin).post(f"/runs/{run}/labels", data={"add": "bad"})
    assert answer.status_code == 403
    assert labels.read(tmp_path / run).tags == ()


def test_a_film_waits_for_a_policy_and_says_why_it_cannot_be_made(tmp_path, monkeypatch):
    run = add_run(tmp_path, 0)
    monkeypatch.setattr("sys.executable", "/bin/false")
    page = client(tmp_path)
    before = page.get(f"/runs/{run}").text
    assert "There is no policy that could be filmed" in before
    assert "<button>Film" not in before
    (tmp_path / run / "checkpoints" / "best").mkdir(parents=True)
    assert "<button>Film" in page.get(f"/runs/{run}").text
    page.post(f"/runs/{run}/film/failures")
    wait_for(lambda: "it ended with 1" in page.get(f"/runs/{run}").text)
    assert page.get(f"/runs/{run}/film/failures").status_code == 404
    (tmp_path / run / "play.mp4").write_bytes(b"film")
    part = page.get(f"/runs/{run}/film/episodes", headers={"range": "bytes=0-1"})
    assert (part.status_code, part.content) == (206, b"fi")


def test_port_that_is_taken_is_named(tmp_path):
    with socket.socket() as taken, Store(Store.default_url(tmp_path)) as store:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(MachineError, match=f"127.0.0.1:{port}: cannot listen"):
            serve(tmp_path, store, host="127.0.0.1", port=port, ready=print)
        with pytest.raises(MachineError, match=r"cannot listen .*; --host names an address of this machine"):
            serve(tmp_path, store, host="203.0.113.9", port=0, ready=print)  # of documentation: no machine has it
        code, out, err = call(app, "--runs", str(tmp_path), "--port", str(port))
    assert (code, out) == (3, "")
    assert err.startswith(f"127.0.0.1:{port}: cannot listen")


@pytest.mark.parametrize(
    ("ending", "code"), [("sys.exit(255)", 3), ("os.kill(os.getppid(), signal.SIGTERM), time.sleep(60)", 143)]
)
def test_tensorboard_ends_with_its_command_and_with_a_known_code(tmp_path, monkeypatch, ending, code):
    start, before = subprocess.Popen, signal.getsignal(signal.SIGTERM)
    program = [sys.executable, "-c", f"import os, signal, sys, time; {ending}"]
    monkeypatch.setattr("subprocess.Popen", lambda _: start(program))
    try:
        karolos("board", "--runs", tmp_path, code=code)
    finally:
        signal.signal(signal.SIGTERM, before)


def test_what_is_shown_is_told_with_the_address(tmp_path, monkeypatch):
    monkeypatch.setattr("uvicorn.Server.run", lambda *_, **__: None)  # as if Ctrl-C came at once
    code, out, err = call(app, "--runs", str(tmp_path), "--port", "0")
    assert (code, err) == (0, f"shows {tmp_path}; Ctrl-C ends it\n")
    assert re.fullmatch(r"http://127\.0\.0\.1:[1-9]\d*/\n", out)


def test_others_draw_while_a_long_comparison_is_drawn(tmp_path):
    application = Application(tmp_path, Store(Store.default_url(tmp_path)))
    other = []

    def long() -> str:
        thread = threading.Thread(target=lambda: other.append(application._once("short", lambda: "drawn")))
        thread.start()
        thread.join(10)
        return "long"

    assert application._once("long", long) == "long"
    assert other == ["drawn"]


def test_list_averages_finished_runs_alone_and_names_all_that_people_named(tmp_path):
    add_run(tmp_path, 0)
    add_run(tmp_path, 1, name="reach-mine", successes=(0,), state="stopped")
    store = Store(Store.default_url(tmp_path))
    [row] = experiment_rows(store, find_experiments(store).experiments)
    assert row.name == "reach-mine, reach"
    assert (row.value, "1 of 2 seeds not finished, left out" in row.interval) == ("0.950", True)


def test_a_client_that_leaves_while_it_sends_a_form_is_no_error(tmp_path):
    run, sent = add_run(tmp_path, 0), []

    async def receive() -> dict[str, str]:
        return {"type": "http.disconnect"}

    async def send(message: dict[str, object]) -> None:
        sent.append(message)

    scope = {"type": "http", "method": "POST", "path": f"/runs/{run}/labels", "query_string": b"", "headers": []}
    asyncio.run(Application(tmp_path, Store(Store.default_url(tmp_path))).asgi()(scope, receive, send))
    assert sent[0]["status"] == 400
