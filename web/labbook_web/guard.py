"""Access control of the app: hosts, a token on shared networks, request sizes, and the content security policy.

Every response carries the policy, which keeps a page from requesting anything of another machine.
"""

import hmac
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

ADDRESS_LIMIT = 4000
"""Characters of path and query."""
BODY_LIMIT = 100_000
CONCURRENT_LIMIT = 64
"""Largest number of concurrent requests; further ones get status 503."""
COOKIE = "labbook-token"
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; font-src 'self'; "
    "connect-src 'self'; frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'self'"
)
"""Policy of all pages. Inline styles are allowed, since Plotly inserts its own; inline scripts are not."""
VIEWER_POLICY = (
    "default-src 'self'; script-src 'self' 'wasm-unsafe-eval' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; connect-src 'self' data: blob:; worker-src 'self' blob:; base-uri 'none'; "
    "frame-ancestors 'self'"
)
"""Policy of the rerun viewer, which starts by an inline script."""


class Guard:
    """ASGI middleware that refuses requests before the app sees them.

    Args:
        app: The app.
        hosts: Allowed values of the Host header, with port; empty: any.
        token: Secret that a client gives once, in the query, and then keeps in a cookie; empty: none is needed.
    """

    def __init__(self, app: ASGIApp, hosts: frozenset[str] = frozenset(), token: str = ""):
        self._app, self._hosts, self._token = app, hosts, token
        self._busy = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        refusal = self._refusal(scope)
        app = refusal or self._app
        self._busy += 1
        try:
            await app(scope, _with_body_limit(receive), _with_headers(scope, send))
        finally:
            self._busy -= 1

    def _refusal(self, scope: Scope) -> ASGIApp | None:
        """Response in place of the app's to a request that is refused; None to one that passes."""
        headers = Headers(scope=scope)
        if self._busy >= CONCURRENT_LIMIT:
            return _text(f"The app is working on {CONCURRENT_LIMIT} answers; ask again in a moment.", 503)
        if len(scope.get("raw_path", b"")) + len(scope["query_string"]) > ADDRESS_LIMIT:
            return _text("The address is too long.", 414)
        host = headers.get("host", "")
        if self._hosts and host not in self._hosts:  # a page elsewhere may have given its own name our address
            return _text(f"The app does not answer as {host[:100]}; use the address that `labbook web` printed.", 421)
        if scope["method"] not in ("GET", "HEAD", "POST"):
            return _text("Only GET, HEAD and POST are answered.", 405)
        if scope["method"] == "POST" and (why := _origin_refusal(headers, host)):
            return _text(why, 403)
        try:
            length = int(headers.get("content-length") or 0)
        except ValueError:
            return _text("The Content-Length of the request is not a number.", 400)
        if not 0 <= length <= BODY_LIMIT:
            return _text(f"More than {BODY_LIMIT} bytes were sent.", 413)
        return self._token_refusal(scope, headers) if self._token else None

    def _token_refusal(self, scope: Scope, headers: Headers) -> ASGIApp | None:
        token = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        if token and hmac.compare_digest(token.encode(), self._token.encode()):
            answer = RedirectResponse("/" + scope["path"].lstrip("/"), 303)  # of two slashes the second names a host
            answer.set_cookie(COOKIE, token, httponly=True, samesite="strict", max_age=30 * 24 * 3600)
            return answer
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        except CookieError:
            cookie = None
        if cookie is not None and hmac.compare_digest(cookie.value.encode(), self._token.encode()):
            return None
        return _text("Open the address with the token that `labbook web` has printed.", 401)


def _origin_refusal(headers: Headers, host: str) -> str:
    """Reason to refuse a POST from another site (cross-site request forgery); empty for one of our own pages."""
    origin = headers.get("origin")
    if headers.get("sec-fetch-site", "same-origin") != "same-origin":
        return "The request came from another site."
    if origin is None or urlsplit(origin).netloc != host:
        return "The request did not come from a page of this app."
    return ""


def _with_body_limit(receive: Receive) -> Receive:
    """Limit the body to BODY_LIMIT, whatever its Content-Length says: beyond it the app sees a disconnect."""
    received = 0

    async def wrapped() -> Message:
        nonlocal received
        message = await receive()
        received += len(message.get("body", b""))
        if received > BODY_LIMIT:
            return {"type": "http.disconnect"}
        return message

    return wrapped


def _with_headers(scope: Scope, send: Send) -> Send:
    """Add the headers of security to every response."""
    policy = VIEWER_POLICY if scope["path"].startswith("/viewer/") else POLICY

    async def wrapped(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers["content-security-policy"] = policy
            headers["x-content-type-options"] = "nosniff"
            headers["referrer-policy"] = "no-referrer"
            headers["cross-origin-resource-policy"] = "same-origin"
            headers["cross-origin-opener-policy"] = "same-origin"
            headers.setdefault("cache-control", "no-store")
        await send(message)

    return wrapped


def _text(text: str, status: int) -> ASGIApp:
    return PlainTextResponse(f"{text}\n", status)
