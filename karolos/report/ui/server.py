"""Serves the pages until Ctrl-C, for requests to this machine's names (with a token beyond loopback) and own forms."""

from __future__ import annotations

import errno
import hmac
import secrets
import socket
from collections.abc import Callable, Collection
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import quote, urlsplit

import uvicorn
from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ...errors import MachineError
from ...store import Store
from ...system import listen_alone
from .app import Application

LOOPBACK = ("localhost", "127.0.0.1", "::1")
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; connect-src 'self'; img-src 'self' data:; "
    "media-src 'self'; style-src 'self' 'unsafe-inline'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "same-origin",  # without any, a form's Origin would be null
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-cache",
}
"""Default headers of answers. Matplotlib's figures contain inline styles."""


class RequestGuard:
    """Refuses foreign requests before the application sees them.

    * A request must name one of our hosts: a foreign page whose name was later bound to this address reads nothing.
    * If there is a token, a request has it once in its address, and later in a cookie.
    * A form must come from our own page.

    If there are other `hosts` than those of loopback, addresses are let through as well: no name of a stranger is one.
    Without a token everybody who reaches the port is accepted. All ports of a machine share cookies.
    """

    def __init__(self, app: ASGIApp, *, hosts: Collection[str], token: str | None, cookie: str) -> None:
        self._app, self._hosts, self._token, self._cookie = app, hosts, token, cookie

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        answer = self._refusal(Request(scope)) or self._app
        await answer(scope, receive, with_headers)

    def _refusal(self, request: Request) -> Response | None:
        """The answer to a refused request; None for an accepted one."""
        if not _is_ours(request.headers.get("host", ""), self._hosts):
            return PlainTextResponse("this page is not known by that name; use the address that karolos printed", 421)
        if self._token is not None:
            given = request.query_params.get("token")
            if given is not None and self._is_token(given):
                answer = RedirectResponse(request.url.remove_query_params("token"), 303)
                answer.set_cookie(self._cookie, self._token, httponly=True, samesite="lax")
                return answer
            if not self._is_token(request.cookies.get(self._cookie, "")):
                return PlainTextResponse("open the address with the token that `karolos ui` printed", 403)
        if request.method not in ("GET", "HEAD"):
            # Browsers name the origin of every form that is sent, and scripts cannot set it.
            origin = request.headers.get("origin", "")
            if not origin or urlsplit(origin).netloc != request.headers.get("host"):
                return PlainTextResponse("this form was sent by another page", 403)
        return None

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), str(self._token).encode())


def _is_ours(host: str, hosts: Collection[str]) -> bool:
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    if name in hosts:
        return True
    try:
        return bool(ip_address(name)) and not set(hosts) <= set(LOOPBACK)
    except ValueError:
        return False


def serve(
    runs: Path, store: Store, *, host: str, port: int, token: str | None = None, ready: Callable[[str], None]
) -> None:
    """Serve the pages of a runs folder on a name or address, and a port (0: any free one).

    Without a token there is a random one beyond loopback, and none on loopback. `ready` gets the address for a browser
    once the page can be opened. Raises MachineError if it is impossible to listen there.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family)
    listen_alone(listener)
    try:
        listener.bind((host, port))
        listener.listen(128)
    except OSError as error:
        listener.close()
        taken = error.errno in (errno.EADDRINUSE, errno.EACCES)  # EACCES: a port below 1024
        hint = "name another with --port, or 0 for a free one" if taken else "--host names an address of this machine"
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
