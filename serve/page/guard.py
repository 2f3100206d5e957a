"""Who may read the page: a browser that asked for this machine by name, or one that has the token."""

import hmac
from typing import Any

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
COOKIE = "softslide_token"
COMMANDS = ("/zero",)  # what changes the stream
# A page of this server, and nothing from elsewhere: a browser runs no other script, and no other page frames it.
HEADERS = [
    (
        "Content-Security-Policy",
        "default-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    ("X-Content-Type-Options", "nosniff"),
    ("Referrer-Policy", "no-referrer"),
    ("Cross-Origin-Resource-Policy", "same-origin"),
    # A browser must not keep the page of another release.
    ("Cache-Control", "no-cache"),
]


class Guard:
    """An ASGI application before another one.

    Every request has to carry the token: as `?token=` once, after that in a cookie. alone: only this machine can
    connect. Then what is opened here brings the cookie, and COMMANDS alone need it; but a page elsewhere can have its
    own name resolve to this machine (DNS rebinding), so the host has to be one of LOOPBACK.
    """

    def __init__(self, application: Any, token: str, alone: bool) -> None:
        self._application, self._token, self._alone = application, token, alone

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        from starlette.requests import HTTPConnection
        from starlette.responses import PlainTextResponse

        request = HTTPConnection(scope)
        host, origin = request.headers.get("host", ""), request.headers.get("origin")
        # A page of another origin must not read the stream through its visitor's browser.
        foreign = origin is not None and origin.partition("://")[2] != host
        asked = _same(request.query_params.get("token", ""), self._token)
        # Cookies are of a host, whatever its port: another stream's page must not overwrite this one's.
        cookie = f"{COOKIE}_{scope['server'][1]}"
        named = asked or _same(request.cookies.get(cookie, ""), self._token)
        here = self._alone and _name(host) in LOOPBACK
        if foreign or not (named or (here and scope["path"] not in COMMANDS)):
            refusal = PlainTextResponse("403: open the address that softslide serve prints\n", 403)
            await refusal(scope, receive, send)
            return

        async def answer(message: Any) -> None:
            brings = asked or (here and scope["path"] == "/")
            if brings and message["type"] == "http.response.start":
                kept = f"{cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/"
                message["headers"] = [*message["headers"], (b"set-cookie", kept.encode())]
            await send(message)

        await self._application(scope, receive, answer)


def _name(host: str) -> str:
    """The host without its port."""
    return host if host.endswith("]") else host.rpartition(":")[0] or host


def _same(given: str, wanted: str) -> bool:
    return hmac.compare_digest(given.encode("utf-8", "replace"), wanted.encode())
