"""Serves the site on this host alone, with what the logbook holds when a page asks.

It answers GET only, on 127.0.0.1. A page of another site can neither read the answers (no CORS)
nor load them as scripts, nor reach them under a name of its own (the Host is checked).
"""

import webbrowser
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Lock

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.runner.compare.results import Results, open_results
from seatrial.runner.compare.site import contents
from seatrial.runner.compare.site.measures import StoredMeasures
from seatrial.runner.compare.site.scripts import (
    FAILURES,
    PROGRESS,
    RUN,
    SUMMARY,
    coefficient_script,
    metric_script,
    script_of,
)
from seatrial.runner.compare.site.static_folder import INDEX, assets

HOST = "127.0.0.1"
TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class Site:
    """The files of the page, and the scripts of one logbook, kept until the logbook changes."""

    def __init__(self, database: str, results_dir: Path | None) -> None:
        self._database, self._results_dir = database, results_dir
        self._assets = assets()
        self._measures = StoredMeasures()
        self._lock = Lock()  # one thread computes; the others take what it kept
        self._version = ""
        self._kept: dict[str, str] = {}

    def file(self, path: str) -> bytes | None:
        """Return the content at a path below the root; None if there is none."""
        if path in ("", INDEX):
            return self._assets[INDEX]
        if path.startswith("assets/"):
            return self._assets.get(path.removeprefix("assets/"))
        if not path.startswith("data/"):
            return None
        with open_results(self._database, self._results_dir) as results:
            if path == PROGRESS:  # which waits for nothing
                text: str | None = script_of(path, contents.progress(results))
            else:
                with self._lock:
                    text = self._script(results, path)
        return None if text is None else text.encode("ascii")

    def _script(self, results: Results, name: str) -> str | None:
        now = contents.version(results)
        if now != self._version:
            self._version, self._kept = now, {}
        if name not in self._kept:
            tell = self._teller(results, name)
            if tell is None:
                return None
            self._kept[name] = script_of(name, tell())
        return self._kept[name]

    def _teller(self, results: Results, name: str) -> Callable[[], object] | None:
        """Return what computes the content of a script; None if there is no such script."""
        if name == SUMMARY:
            return lambda: contents.summary(results, self._database, self._measures)
        if name == FAILURES:
            return lambda: contents.failures(results)
        if match := RUN.fullmatch(name):
            return lambda: contents.one_run(results, int(match[1]))
        for metric in results.metric_names():
            if metric_script(metric) == name:
                return lambda: contents.metric(results, metric)
        for term in results.terms():
            if coefficient_script(term) == name:
                return lambda: contents.coefficient(results, term)
        return None


class Handler(BaseHTTPRequestHandler):
    """Answers one request; `site` and `port` are those of the server."""

    site: Site
    server: ThreadingHTTPServer

    def do_GET(self) -> None:
        """Answer with a file of the site."""
        port = self.server.server_address[1]
        if self.headers.get("Host") not in (f"{HOST}:{port}", f"localhost:{port}"):
            return self._answer(HTTPStatus.FORBIDDEN, b"expected the host 127.0.0.1")
        path = self.path.partition("?")[0].lstrip("/")
        try:
            content = self.site.file(path)
        except SeatrialError as error:
            return self._answer(HTTPStatus.NOT_FOUND, str(error).encode("utf-8", "replace"))
        if content is None:
            return self._answer(HTTPStatus.NOT_FOUND, b"there is no such file")
        return self._answer(HTTPStatus.OK, content, TYPES.get(Path(path or INDEX).suffix))

    def _answer(self, status: HTTPStatus, content: bytes, kind: str | None = None) -> None:
        self.send_response(status)
        self.send_header("Content-Type", f"{kind or 'text/plain'}; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *arguments: object) -> None:
        """Say nothing of requests."""


def serve(
    database: str,
    port: int,
    results_dir: Path | None,
    announce: Callable[[str], None],
    open_browser: bool = False,
) -> None:
    """Serve the site of a logbook until interrupted.

    `port` is that on 127.0.0.1, 0 for a free one; `announce` is told the address. Raises
    LogbookError if there is no logbook, and ConfigurationError if the port is taken.
    """
    with open_results(database, results_dir):
        pass  # now, rather than with the first page
    handler = type("SiteHandler", (Handler,), {"site": Site(database, results_dir)})
    try:
        server = ThreadingHTTPServer((HOST, port), handler)
    except OSError as error:
        raise ConfigurationError(
            f"--port: {port}: {error.strerror}; expected a free port"
        ) from error
    url = f"http://{HOST}:{server.server_address[1]}/"
    announce(url)
    if open_browser:
        webbrowser.open(url)
    with server:
        server.serve_forever()
