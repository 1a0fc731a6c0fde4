"""The HTTP server: who may ask, how much may be sent, and errors as JSON."""

from __future__ import annotations

import hmac
import ipaddress
import json
import socket
import sys
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from io import BufferedReader
from threading import BoundedSemaphore
from time import monotonic
from typing import Any
from urllib.parse import urlsplit

from servoscope.errors import InvalidInputError, ServoscopeError
from servoscope.service.answers import LARGEST_BODY, Answers
from servoscope.service.description import openapi, page
from servoscope.wording import one_line, printable

MOST_CONNECTIONS = 32
"""Connections at a time; others are closed at once."""

SHORTEST_TOKEN = 16
"""Fewest characters of a token."""

LONGEST_S = 30.0
"""A body that takes longer to arrive is not waited for."""

_TIMEOUT_S = 10.0


class Refused(Exception):
    """A request that is not answered, with the status that says why."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status = status


class Server(ThreadingHTTPServer):
    """Answers at an address.

    Parameters
    ----------
    answers : Answers
    host : str
        Address to listen at. Where others than this machine reach it, a token is needed.
    port : int
        0 for any that is free.
    token : str, optional
        What requests must bring as ``Authorization: Bearer``.
    names : iterable of str
        Names, besides addresses and ``localhost``, that the service may be called by. A page of
        another site can make a browser call it by any name that is its own; these are refused.

    Raises
    ------
    InvalidInputError
        If a token is missing or too short, or the address cannot be listened at.
    """

    daemon_threads = True
    request_queue_size = 64

    def __init__(
        self,
        answers: Answers,
        host: str = "127.0.0.1",
        port: int = 0,
        *,
        token: str | None = None,
        names: tuple[str, ...] = (),
    ) -> None:
        if token is None and not is_loopback(host):
            raise InvalidInputError(
                f"At {host} others than this machine reach the service, so it needs a token: give "
                "--token-file, or SERVOSCOPE_TOKEN."
            )
        if token is not None and not (len(token) >= SHORTEST_TOKEN and token.isascii()):
            raise InvalidInputError(
                f"A token must have at least {SHORTEST_TOKEN} ASCII characters, got {len(token)}."
            )
        if not 0 <= port < 2**16:
            raise InvalidInputError(f"A port must be from 0 to 65535, got {port}.")
        self.answers, self.token = answers, token
        self.names = {"localhost", host.lower(), *(name.lower() for name in names)}
        self.free = BoundedSemaphore(MOST_CONNECTIONS)
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            super().__init__((host, port), Handler)
        except OSError as error:
            reason = one_line(error.strerror or error)
            raise InvalidInputError(
                f"Nothing can listen at port {port} of {host} ({reason}); choose another --port."
            ) from error

    @property
    def url(self) -> str:
        """Where it listens."""
        host, port = self.server_address[:2]
        return f"http://{f'[{host!s}]' if ':' in str(host) else host!s}:{port}/"

    def server_bind(self) -> None:
        """As of the base class, without asking for the name of the address."""
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = map(str, self.server_address[:2])  # type: ignore[assignment]

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own, or refuse where there are too many."""
        if not self.free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """What that thread does."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say on one line what went wrong with a connection; it is closed."""
        error = sys.exception()
        if not isinstance(error, ConnectionError | TimeoutError):
            print(f"servoscope: {one_line(error)}", file=sys.stderr)


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches an address.

    Examples
    --------
    >>> is_loopback("127.0.0.1"), is_loopback("::1"), is_loopback("0.0.0.0")
    (True, True, False)
    """
    return host == "localhost" or (_is_address(host) and ipaddress.ip_address(host).is_loopback)


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


class Handler(BaseHTTPRequestHandler):
    """One connection."""

    protocol_version = "HTTP/1.1"
    timeout = _TIMEOUT_S
    server: Server
    rfile: BufferedReader

    def do_GET(self) -> None:
        """Answer a request that brings nothing."""
        self._answer({"/": self._page, "/health": self._health, "/openapi.json": self._openapi})

    def do_HEAD(self) -> None:
        """The same without the content."""
        self.do_GET()

    def do_POST(self) -> None:
        """Answer a request that brings an image."""
        self._answer({"/estimate": self._estimate})

    def _answer(self, known: dict[str, Callable[[], None]]) -> None:
        try:
            self._check_caller()
            path = urlsplit(self.path).path
            if path not in known:
                is_known = path in ("/", "/health", "/openapi.json", "/estimate")
                status = 405 if is_known else 404
                raise Refused(status, f"There is no {self.command} {path[:100]}; see GET /.")
            known[path]()
        except Refused as error:
            self._refuse(error.status, str(error))
        except ServoscopeError as error:
            self._refuse(422, str(error))
        except (ConnectionError, TimeoutError):
            self.close_connection = True
        except Exception as error:
            print(f"servoscope: {type(error).__name__}: {one_line(error)}", file=sys.stderr)
            self._refuse(500, "The service failed on this request; its terminal says why.")

    def _check_caller(self) -> None:
        """Refuse pages of other sites, which a browser may be led to call this address from."""
        host = self.headers.get("Host", "")
        name = _name_of(host)
        if not (_is_address(name) or name in self.server.names):
            raise Refused(403, f"It is not called {one_line(name, 100)!r}; use its address.")
        origin = self.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            raise Refused(403, "Pages of other sites may not call it.")

    def _check_token(self) -> None:
        wanted = self.server.token
        given = self.headers.get("Authorization", "").encode("latin-1", "replace")
        if wanted is not None and not hmac.compare_digest(given, f"Bearer {wanted}".encode()):
            raise Refused(401, "It needs the header Authorization: Bearer TOKEN.")

    def _estimate(self) -> None:
        self._check_token()
        if "Transfer-Encoding" in self.headers:
            raise Refused(411, "The body must come whole; send its Content-Length.")
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit() and len(length) < 19):
            raise Refused(411, "The Content-Length of the image is missing; send it.")
        if int(length) > LARGEST_BODY:
            raise Refused(413, f"An image may have {LARGEST_BODY} bytes, this has {length}.")
        self._send_json(200, self.server.answers.estimate(self._body(int(length))))

    def _body(self, length: int) -> bytes:
        until, parts, left = monotonic() + LONGEST_S, [], length
        while left:
            part = self.rfile.read1(left)
            if not part:
                raise Refused(400, f"The body must have {length} bytes, got {length - left}.")
            parts.append(part)
            left -= len(part)
            if left and monotonic() > until:
                raise Refused(408, f"The body took longer than {LONGEST_S:g} s.")
        return b"".join(parts)

    def _health(self) -> None:
        self._send_json(200, self.server.answers.health())

    def _openapi(self) -> None:
        height, width = self.server.answers.model.image_shape
        self._send_json(200, openapi((width, height), self.server.token is not None))

    def _page(self) -> None:
        content, policy = page()
        headers = {"Content-Type": "text/html; charset=utf-8", "Content-Security-Policy": policy}
        self._send(200, content, headers)

    def _refuse(self, status: int, message: str) -> None:
        self.close_connection = True  # what is left of the request is not read
        try:
            self._send_json(status, {"error": one_line(message, 1000)})
        except (ConnectionError, TimeoutError):
            return

    def _send_json(self, status: int, value: Any) -> None:
        content = json.dumps(value, allow_nan=False).encode()
        self._send(status, content, {"Content-Type": "application/json"})

    def _send(self, status: int, content: bytes, headers: dict[str, str]) -> None:
        self.send_response(status)
        common = {
            "Content-Length": str(len(content)),
            "Cache-Control": "no-store",
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
        }
        if status == 401:
            common["WWW-Authenticate"] = "Bearer"
        if self.close_connection:
            common["Connection"] = "close"
        for name, value in {**headers, **common}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """What the base class refuses, as JSON."""
        self._refuse(int(code), message or self.responses.get(code, ("It is refused.",))[0])

    def version_string(self) -> str:
        """What answers say of the program."""
        return "servoscope"

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are not listed."""


def _name_of(host: str) -> str:
    """The name in a Host header, without the port, in small letters."""
    try:
        return printable(urlsplit(f"//{host}").hostname or "")
    except ValueError:
        return ""
