"""Serves the pages until Ctrl-C."""

from __future__ import annotations

import secrets
import socket
from collections.abc import Callable
from pathlib import Path
from urllib.parse import quote

import uvicorn
from starlette.types import ASGIApp

from ..errors import MachineError
from ..store import Store
from ..system import listen_alone
from .app import Application
from .guard import LOOPBACK, RequestGuard


def serve(
    runs: Path, store: Store, *, host: str, port: int, token: str | None = None, ready: Callable[[str], None]
) -> None:
    """Serve the pages of a runs folder.

    Args:
        runs: the folder.
        store: its index.
        host: name or address to listen on. Beyond loopback there is always a token.
        port: 0 takes a free one.
        token: asked for; None or "" is a random one beyond loopback, and none on it.
        ready: gets the address for a browser once the page can be opened.

    Raises:
        MachineError: host and port cannot be listened on.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family)
    listen_alone(listener)
    try:
        listener.bind((host, port))
        listener.listen(128)
    except OSError as error:
        listener.close()
        hint = "name another with --port, or 0 for a free one"
        raise MachineError(f"cannot listen ({error.strerror or error})", where=f"{host}:{port}", hint=hint) from error
    port = listener.getsockname()[1]
    beyond = host not in LOOPBACK
    token = token or (secrets.token_urlsafe(24) if beyond else None)
    application = Application(runs, store)
    app = guarded(application, host, port, token)
    name = socket.gethostname() if host in ("0.0.0.0", "::") else host
    query = "?token=" + quote(token, safe="") if token else ""
    ready(f"http://{f'[{name}]' if ':' in name else name}:{port}/{query}")
    config = uvicorn.Config(app, log_level="warning", access_log=False, ws="none", lifespan="off", server_header=False)
    try:
        uvicorn.Server(config).run(sockets=[listener])
    except KeyboardInterrupt:
        pass
    finally:
        application.films.end()
        listener.close()


def guarded(application: Application, host: str, port: int, token: str | None) -> ASGIApp:
    """The application behind its guard."""
    own = () if host in LOOPBACK else (host.lower(), socket.gethostname().lower(), socket.getfqdn().lower())
    return RequestGuard(application.asgi(), hosts={*LOOPBACK, *own}, token=token, cookie=f"karolos_{port}")
