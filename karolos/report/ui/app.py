"""The application: addresses and their pages. Nothing is computed here: the store answers, `karolos.report` draws."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, quote, urlencode

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, HTMLResponse, RedirectResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from ...comparison import Contender, compare, gather
from ...comparison.contenders import labels_of
from ...errors import KarolosError, NoSuchRunError, RunError, UsageError
from ...records import RunFolder, checkpoint, labels
from ...records.evaluation import Evaluation
from ...records.run_records import UNFINISHED, RunRecord, RunSummary, flatten
from ...records.sweep_records import FOLDER as SWEEPS
from ...records.sweep_records import sweeps
from ...store import Store, check
from ...store.experiments import ORDERS, find_experiments
from ...system import files
from .. import page, tables
from ..comparison_figures import comparison_figures, learning
from ..figures import short
from ..page import Section, comparison_sections
from ..tables import Table, evaluations_table, heading, setting
from . import films
from .rows import SIGNS, experiment_rows, sparkline

HERE = Path(__file__).parent
EXPERIMENTS, MOST_COMPARED, LISTED = 50, 12, 12
"""Largest number of experiments on a page and in a comparison, and of listed failures."""
MOST_POSTED = 1 << 20
"""Largest size of a form in bytes: more than the longest note."""
SHOWN = ("run", "state", "experiment", "tags", "note", "versions")
"""Facts of a run that the list of facts on its page leaves out."""
KEPT = 8
"""Number of drawn comparisons and runs that are kept."""
REPORTS, WRITTEN = (SWEEPS, "suites", "transfers"), ("report.html", "figures/*.svg")
"""Folders in the runs folder that hold folders of reports, and the shown files. A report has its page at its path, so
that its links to run folders lead to the pages of the runs."""


class Application:
    """The pages over one runs folder and its index."""

    def __init__(self, runs: Path, store: Store) -> None:
        self._runs, self._store, self.films = runs, store, films.Films()
        self._templates = page.templates(HERE / "pages", page.FOLDER)
        self._keeping = threading.Lock()
        self._drawn: OrderedDict[object, tuple[threading.Lock, list[Any]]] = OrderedDict()

    def asgi(self) -> Starlette:
        """Entry point for a server."""
        routes = [
            Route("/", self.experiments),
            Route("/compare", self.compared),
            *(Route(f"/runs/{kind}/{{name}}/{{file:path}}", partial(self.report, kind)) for kind in REPORTS),
            Route("/runs/{run}", self.run),
            Route("/runs/{run}/labels", self.label, methods=["POST"]),
            Route("/runs/{run}/film/{kind}", self.film, methods=["POST"]),
            Route("/runs/{run}/film/{kind}", self.film_file),
            Route("/runs/{run}/tests/{test}", self.test),
            *(Route(f"/{kind}", partial(self.reports, kind)) for kind in REPORTS),
            Route("/folders", self.folders),
            Route("/static/page.css", lambda _: FileResponse(page.FOLDER / "page.css")),
            Mount("/static", StaticFiles(directory=HERE / "static")),
        ]
        handlers = {KarolosError: self._explained, HTTPException: self._refused, ClientDisconnect: _left}
        return Starlette(routes=routes, exception_handlers=handlers)

    def experiments(self, request: Request) -> Response:
        """Experiments with their seeds, newest first. An open page is updated."""
        asked = request.query_params
        where, order = asked.get("where", "").strip(), asked.get("order", "created")
        trials, first = "trials" in asked, _whole(asked.get("from"))
        going = [(run.run, run.state, run.steps) for state in UNFINISHED for run in self._store.runs(state=state)]
        seen = _digest(self._store.version(), going)
        if asked.get("seen") == seen:
            return Response(status_code=204)
        shown: dict[str, Any] = {"problem": None, "rows": [], "total": 0}
        try:
            options: dict[str, Any] = {"trials": trials, "order": order, "offset": first, "limit": EXPERIMENTS}
            found = find_experiments(self._store, where or None, **options)
            shown |= {"rows": experiment_rows(self._store, found.experiments), "total": found.total}
            shown["hidden"] = not (where or trials or found.total) and self._store.runs(limit=1, trials=True)
        except UsageError as error:
            shown["problem"] = str(error)
        kept: dict[str, Any] = {"where": where, "order": order, **({"trials": 1} if trials else {})}

        def address(**changes: object) -> str:
            return "/?" + urlencode({key: value for key, value in (kept | changes).items() if value})

        last = first + len(shown["rows"])
        pages: dict[str, Any] = {"first": first + 1, "last": last}
        pages["before"] = address(**{"from": max(first - EXPERIMENTS, 0)}) if first else None
        pages["after"] = address(**{"from": last}) if last < shown["total"] else None
        live = address(**{"from": first, "seen": seen})
        return self._page("experiments.html", **kept, **shown, **pages, address=address, live=live, orders=ORDERS)

    def compared(self, request: Request) -> Response:
        """Experiments side by side, or one with its seeds: the page of `karolos compare`."""
        hashes = list(dict.fromkeys(request.query_params.getlist("e")))
        if not 1 <= len(hashes) <= MOST_COMPARED:
            raise UsageError(f"{len(hashes)} experiments to compare", hint=f"choose 1 to {MOST_COMPARED} in the list")
        selected = [self._store.runs(experiment=experiment) for experiment in hashes]
        if not all(selected):
            raise NoSuchRunError("an experiment has no runs any more", hint="go back to the list")
        key = ("comparison", tuple(hashes), self._store.version())

        def draw() -> Any:
            contenders = [gather(self._store, *one) for one in zip(selected, labels_of(selected), strict=True)]
            comparison = compare(contenders, store=self._store)
            sections = comparison_sections(comparison, comparison_figures(comparison))
            return comparison, self._shown(sections, comparison.labels)

        comparison, shown = self._once(key, draw)
        return self._page("compare.html", comparison=comparison, shown=shown, hashes=hashes)

    def run(self, request: Request) -> Response:
        """One run: learning curve, tests, failures, films, settings and events."""
        summary = self._found(request)
        path = Path(summary.folder)
        tested = _digest(summary.state, *(_changed(path / name) for name in ("tests.jsonl", "final.jsonl")))
        seen = _digest(tested, _changed(path / "state.json"))
        if request.query_params.get("seen") == seen:
            return Response(status_code=204)
        folder, record, broken = self._opened(summary.folder)
        record = record or self._store.records([summary])[0]
        about: Mapping[str, Any] = folder.description() if folder else {}
        tests, final = (folder.tests(), folder.final()) if folder else (record.tests, {})
        events = folder.events() if folder else ()
        transfers, unreadable = folder.transfers() if folder else ((), ())

        def draw() -> Any:
            if not record.tests:
                return ""
            comparison = compare([Contender(record.summary.name, (record,))])
            drawings = [learning(comparison, "steps"), learning(comparison, "seconds")]
            return self._shown([Section(figures=drawings)], [])

        run, settings = record.summary, _settings(record.spec, about)
        last = final.get("last", tests[-1] if folder and tests else None)
        failures = _episodes(last)[1] if last and last.has_success else None
        return self._page(
            "run.html",
            run=run,
            state=tables.run_state(run),
            sign=SIGNS.get(run.state),
            facts={name: value for name, value in tables.run_facts(run, about).items() if name not in SHOWN and value},
            problems=(*broken, *record.problems, *unreadable),
            live=f"/runs/{quote(run.run)}?seen={seen}" if run.state in UNFINISHED else None,
            shown=self._once(("run", run.run, tested), draw),
            final=evaluations_table(final.values()) if final else None,
            tests=evaluations_table(tests) if tests else None,
            links=[f"/runs/{run.run}/tests/{test.steps}" for test in tests],
            measures=tables.measures_table(last.measures) if last and last.measures else None,
            curves=[_curve(name, tests) for name in last.measures] if last else [],
            failures=failures,
            last=last,
            transfers=tables.transfers_table(transfers) if transfers else None,
            given=[one for one in settings if one[2] != "default"],
            defaults=[one for one in settings if one[2] == "default"],
            events=[_event(event) for event in events],
            films=self._films(folder, failures),
            policy=folder is not None and bool(checkpoint.names(folder.checkpoints)),
        )

    def test(self, request: Request) -> Response:
        """A test of a run, episode by episode."""
        folder, test = self._folder(request), request.path_params["test"]
        known = {str(one.steps): one for one in folder.tests()} | folder.final()
        if test not in known:
            raise NoSuchRunError(f"{folder.id} has no test {test!r}", hint="its page lists its tests")
        table, failures = _episodes(known[test])
        return self._page("test.html", run=folder.id, test=test, table=table, failures=failures, result=known[test])

    async def label(self, request: Request) -> Response:
        """Change tags and note as `karolos runs tag` and `note` do."""
        asked = await _form(request)

        def change() -> None:
            summary = self._found(request)
            chosen = self._store.runs(experiment=summary.experiment) if "all" in asked else [summary]
            for folder in [RunFolder.open(one.folder) for one in chosen]:
                if tag := asked.get("add", "").strip():
                    labels.add_tags(folder.path, [tag])
                if tag := asked.get("remove", ""):
                    labels.remove_tags(folder.path, [tag])
                if "note" in asked:
                    labels.set_note(folder.path, asked["note"].replace("\r\n", "\n").strip())
                self._store.refresh_labels(folder)

        await run_in_threadpool(change)
        return _back(request, "labels")

    def film(self, request: Request) -> Response:
        """Begin to make a film."""
        kind = request.path_params["kind"]
        if kind not in films.FILES:
            raise UsageError(f"there are no films of {kind!r}")
        self.films.begin(self._folder(request), kind)
        return _back(request, "films")

    def film_file(self, request: Request) -> Response:
        """A finished film."""
        path = self._folder(request).path / films.FILES.get(request.path_params["kind"], "none")
        if not path.is_file():
            raise NoSuchRunError(f"there is no {path.name} yet")
        return FileResponse(path, media_type="video/mp4")

    def reports(self, kind: str, _: Request) -> Response:
        """Sweeps, suites or matrices of transfers, with their reports."""
        found = [(sweep, sweep.state()) for sweep in sweeps(self._runs)[0]] if kind == SWEEPS else []
        return self._page("reports.html", kind=kind, written=_written(self._runs / kind), sweeps=found)

    def report(self, kind: str, request: Request) -> Response:
        """A page or figure of a sweep, suite or matrix, without scripts; a page gets a link back."""
        name, file = request.path_params["name"], request.path_params["file"]
        if file not in _written(self._runs / kind).get(name, ()):  # not as a path: it may be invalid
            raise NoSuchRunError("there is no such report", hint=f"the page of {kind} lists them")
        text = (files.below(self._runs / kind, name) / file).read_text("utf-8", "replace")
        text = text.replace("<body>", f'<body>\n<p><a href="/{kind}">{kind.title()}</a></p>', 1)
        policy = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:"
        media = "text/html" if file.endswith(".html") else "image/svg+xml"
        return Response(text, media_type=media, headers={"Content-Security-Policy": policy})

    def folders(self, request: Request) -> Response:
        """Differences between run folders and database: the lines of `karolos db check`."""
        found = list(check(self._store, self._runs)) if "check" in request.query_params else None
        return self._page("folders.html", found=found, folder=self._runs, database=self._store.name)

    def _explained(self, _: Request, error: Exception) -> Response:
        assert isinstance(error, KarolosError)  # the application registers it for these
        return self._page("error.html", 404 if isinstance(error, NoSuchRunError) else 400, problem=str(error))

    def _refused(self, request: Request, error: Exception) -> Response:
        """The answer to an unknown address, or to a wrong method."""
        assert isinstance(error, HTTPException)  # the application registers it for these
        problem = f"{short(request.url.path, 80)}: {error.detail.lower()}"
        return self._page("error.html", error.status_code, problem=problem)

    def _page(self, template: str, status: int = 200, **values: Any) -> Response:
        return HTMLResponse(self._templates.get_template(template).render(values), status)

    def _shown(self, sections: list[Section], contenders: list[str]) -> Any:
        """Sections as markup."""
        parts: Any = self._templates.get_template("sections.html").module
        shown = []
        for section in sections:
            runs = section.table.rows if section.table is not None and section.series else ()
            shown.append(replace(section, links=[f"/runs/{run}" for run, *_ in runs]) if runs else section)
        return parts.show(shown, contenders)

    def _once(self, key: object, draw: Callable[[], Any]) -> Any:
        """The drawing for this key, made now if it is missing. Other keys can be drawn at the same time."""
        with self._keeping:
            drawing, drawn = self._drawn.setdefault(key, (threading.Lock(), []))
            if len(self._drawn) > KEPT:
                self._drawn.popitem(last=False)
        with drawing:
            if not drawn:
                drawn.append(draw())
        return drawn[0]

    def _found(self, request: Request) -> RunSummary:
        """The run in the address."""
        run = request.path_params["run"]
        if found := self._store.runs(ids=[run]):
            return found[0]
        raise NoSuchRunError(f"there is no run {run!r}", hint="the list shows all runs")

    def _folder(self, request: Request) -> RunFolder:
        return RunFolder.open(self._found(request).folder)

    def _opened(self, path: str) -> tuple[RunFolder | None, RunRecord | None, tuple[str, ...]]:
        """A run folder with its record, or the error that prevents reading it."""
        try:
            folder = RunFolder.open(path)
            return folder, folder.record(), ()
        except RunError as error:
            return None, None, (str(error),)

    def _films(self, folder: RunFolder | None, failures: Sequence[int] | None) -> dict[str, tuple[bool, str]]:
        """Kind of film -> whether it exists, and the state of its making."""
        if folder is None:
            return {}
        paths = {kind: folder.path / name for kind, name in films.FILES.items() if failures or kind != "failures"}
        return {kind: (path.is_file(), self.films.state(path)) for kind, path in paths.items()}


def _settings(spec: Mapping[str, Any], about: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Each setting with its value and its origin: command line, spec or default."""
    changed = dict(flatten(about.get("changed") or {}))
    given = [word.partition("=")[0] for word in about.get("command") or () if "=" in word and not word.startswith("-")]

    def origin(path: str) -> str:
        if any(path == key or path.startswith(f"{key}.") for key in given):
            return "command line"
        return "spec" if path in changed else "default" if about.get("changed") is not None else ""

    return [(path, setting(value), origin(path)) for path, value in flatten(spec)]


def _curve(name: str, tests: Iterable[Evaluation]) -> tuple[str, ...]:
    """The sparkline of a measure's mean over training."""
    known = [(test.steps, test.measures[name]["mean"]) for test in tests if name in test.measures]
    return sparkline([[(steps, mean) for steps, mean in known if mean is not None]], is_ratio=False)


def _episodes(result: Evaluation) -> tuple[Table, list[int]]:
    """One row per episode of a test, and the episodes that end without success."""
    numbers = range(result.episodes)
    columns: dict[str, list[str]] = {"episode": [str(place + 1) for place in numbers]}
    if result.has_success:
        columns["success end"] = ["yes" if flag else "no" for flag in result.end]
        columns["at any step"] = ["yes" if flag else "no" for flag in result.any]
    columns["return"] = list(map(tables.number, result.returns))
    columns["steps"] = list(map(tables.count, result.lengths))
    if result.distances is not None:
        columns["distance from goal (m)"] = [f"{far:.4f}" for far in result.distances]
    for name, one in result.measures.items():
        columns[heading(name, one)] = ["-" if value is None else f"{value:.4g}" for value in one.get("values", ())]
    failures = [place for place in numbers if not result.end[place]]
    return Table(list(columns), list(zip(*columns.values(), strict=True))), failures


def _event(event: Mapping[str, Any]) -> tuple[str, str, str]:
    """Time, kind and data of an event."""
    data = {key: value for key, value in event.items() if key not in ("time", "event", "last", "best")}
    shown = ", ".join(f"{key} {setting(value)}" for key, value in data.items())
    return str(event.get("time", ""))[:19].replace("T", " "), str(event.get("event", "")), shown


def _left(_: Request, __: Exception) -> Response:
    """An answer that nobody receives: the client left while it sent a form."""
    return Response(status_code=400)


def _written(root: Path) -> dict[str, list[str]]:
    """Name of a sweep, suite or matrix -> the files of its report, relative to its folder."""
    return {
        folder.name: sorted(path.relative_to(folder).as_posix() for one in WRITTEN for path in folder.glob(one))
        for folder in sorted(root.glob("*"))
        if folder.is_dir()
    }


def _back(request: Request, part: str) -> Response:
    """Redirect to a part of the run's page."""
    return RedirectResponse(f"/runs/{quote(request.path_params['run'])}#{part}", 303)


async def _form(request: Request) -> dict[str, str]:
    """The fields of a submitted form."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > MOST_POSTED:
            raise UsageError(f"a form of more than {MOST_POSTED:,} bytes", hint="shorten the note")
    return dict(parse_qsl(body.decode(errors="replace"), keep_blank_values=True))


def _whole(text: str | None) -> int:
    """A whole number in an address; 0 for anything else."""
    return int(text) if text is not None and text.isdecimal() and len(text) < 10 else 0


def _changed(path: Path) -> tuple[int, int]:
    """Time and size of a file. They change when it is written."""
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_mtime_ns, found.st_size


def _digest(*values: object) -> str:
    return sha256(repr(values).encode()).hexdigest()[:16]
