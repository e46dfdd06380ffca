"""Who may ask: names of this machine, a token beyond loopback, and forms of our own pages."""

from __future__ import annotations

import hmac
from collections.abc import Collection
from ipaddress import ip_address
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOOPBACK = ("localhost", "127.0.0.1", "::1")
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; connect-src 'self'; img-src 'self' data:; "
    "media-src 'self'; style-src 'self' 'unsafe-inline'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "same-origin",  # without any, a form's Origin would be null
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-cache",
}
"""Of every answer that has no others. Matplotlib's figures have styles inside them."""


class RequestGuard:
    """Refuses requests of strangers before the application sees them.

    * A request names a host that is ours: a page whose name was bound to this address later reads nothing.
    * With a token, a request has it in its address once, and then in a cookie.
    * A form comes from our own page.

    Args:
        app: the application.
        hosts: names that requests may give. If there are others than those of loopback, addresses are let through as
            well: no name of a stranger is one.
        token: None lets everybody in who reaches the port.
        cookie: name of the cookie; cookies are shared by all ports of a machine.
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
        """What is answered instead of the page; None for a request that is ours."""
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
        if request.method not in ("GET", "HEAD") and not _from_own_page(request):
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


def _from_own_page(request: Request) -> bool:
    """Browsers name the origin of every form that is sent, and scripts cannot set it."""
    origin = request.headers.get("origin", "")
    return bool(origin) and urlsplit(origin).netloc == request.headers.get("host")
