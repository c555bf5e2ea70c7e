"""Who may speak to the server: the page that it has served itself, on this machine, with its token.

A page elsewhere in the browser cannot read the token, its requests carry another Origin, and a name that was
bent to this machine (DNS rebinding) stands in the Host header.
"""

from __future__ import annotations

import hmac
from dataclasses import dataclass
from typing import Any

from tornado.httputil import HTTPServerRequest

LOOPBACK = "127.0.0.1"
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; font-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
# A report is whole in itself. It may have come with a folder from elsewhere: it gets an origin of its own.
REPORT_POLICY = (
    "sandbox allow-scripts allow-popups; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; base-uri 'none'; form-action 'none'"
)
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
    "X-Frame-Options": "DENY",
}


@dataclass(frozen=True)
class Guard:
    """The token of a server and its port."""

    token: str
    port: int

    @property
    def hosts(self) -> tuple[str, ...]:
        return f"{LOOPBACK}:{self.port}", f"localhost:{self.port}"

    def address(self) -> str:
        return f"http://{LOOPBACK}:{self.port}/{self.token}/"

    def why_not(self, request: HTTPServerRequest, token: str) -> str | None:
        """Why a request is refused; None where it is not. One that changes something must say where it comes
        from."""
        host = request.headers.get_list("Host")
        if len(host) != 1 or host[0].lower() not in self.hosts:
            return "this name is not one of this server"
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return "the address lacks the token that daest app has printed"
        origin = request.headers.get("Origin")
        changes = request.method not in ("GET", "HEAD") or _is_upgrade(request)
        if (origin is None and changes) or (origin is not None and not self.is_own(origin)):
            return "the request comes from another page"
        return None

    def is_own(self, origin: str) -> bool:
        return origin.lower() in {f"http://{host}" for host in self.hosts}


def _is_upgrade(request: HTTPServerRequest) -> bool:
    return request.headers.get("Upgrade", "").lower() == "websocket"


def headers(policy: str = POLICY) -> dict[str, Any]:
    """Headers of every answer."""
    return {**HEADERS, "Content-Security-Policy": policy}
