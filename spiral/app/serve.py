"""The server of the page, on 127.0.0.1 alone, for those who know its token."""

from __future__ import annotations

import os
import re
import secrets
import socket
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from spiral.types.errors import ConfigError

HOST, PORT = "127.0.0.1", 8765
LOCK = ".page.lock"
TOKEN_VARIABLE = "SPIRAL_TOKEN"
_TOKEN = re.compile(r"[A-Za-z0-9_.~-]{16,200}")


def start_app(
    names: tuple[str, ...],
    overrides: tuple[str, ...],
    port: str | None,
    browser: bool,
    plugins: str | None,
    token: str | None = None,
) -> int:
    """``spiral app [out=FOLDER]``: serve the page; the exit code when it ends.

    Raises
    ------
    ConfigError : another key than ``out``, a port that is none or taken, or a weak token.
    """
    from spiral.io.overrides import parse_overrides

    given = {".".join(i.path): i.value for i in parse_overrides(overrides)}
    for key in (*names, *given):
        if key != "out":
            raise ConfigError(
                f"app {key}", "spiral app [out=FOLDER] [--port N] [--token TOKEN] [--no-browser]",
                "choose record and system on the page",
            )  # fmt: skip
    if port is not None and not (port.isdigit() and int(port) < 65536):
        raise ConfigError(f"--port {port}", "a number from 0 to 65535", "leave it out")
    out = Path(str(given.get("out") or "runs")).expanduser()
    serve_until_interrupt(
        out, None if port is None else int(port), browser, plugins, token_for(token)
    )
    return 0


def token_for(given: str | None) -> str:
    """The page's token: the one given, ``SPIRAL_TOKEN``, else a random one.

    Raises
    ------
    ConfigError : one that could be guessed, or that an address cannot hold.
    """
    token = given or os.environ.get(TOKEN_VARIABLE) or secrets.token_urlsafe(32)
    if not _TOKEN.fullmatch(token):
        raise ConfigError(
            "a token of " + (f"{len(token)} characters" if len(token) < 16 else "other characters"),
            "16 to 200 letters, digits, '-', '_', '.' or '~'",
            'export SPIRAL_TOKEN="$(openssl rand -hex 24)"',
        )
    return token


def serve_until_interrupt(
    out: Path, port: int | None, browser: bool, plugins: str | None, token: str
) -> None:
    """Serve the page until Ctrl-C.

    Raises
    ------
    ConfigError : a port that is taken, or a folder that another page works in.
    InputError : a folder that cannot be written.
    """
    with lock_folder(out):
        _run_server(out, port, browser, plugins, token)


@contextmanager
def lock_folder(out: Path) -> Iterator[None]:
    """Lock a folder of runs for one page: two would overwrite each other's studies.

    Raises
    ------
    ConfigError : another page holds it. InputError : a folder that cannot be written.
    """
    from filelock import FileLock, Timeout

    from spiral.io.storage import unwritable_folder_error

    lock = FileLock(out / LOCK, blocking=False)
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout as error:
        raise ConfigError(
            f"a second page on {str(out)!r}", "one page for a folder, in as many tabs as you like",
            "open the address that the first one printed, end it, or out=FOLDER",
        ) from error  # fmt: skip
    except OSError as error:
        raise unwritable_folder_error(out, error) from error
    try:
        yield
    finally:
        lock.release()


def _run_server(
    out: Path, port: int | None, browser: bool, plugins: str | None, token: str
) -> None:
    listening = _listening_socket(port)
    number = int(listening.getsockname()[1])
    import uvicorn

    from spiral.app.guard import TOKEN, Guard
    from spiral.app.session import Session
    from spiral.app.viewer import Viewer

    viewer = Viewer()
    session = Session(out.resolve(), plugins)
    address = f"http://{HOST}:{number}/?{TOKEN}={token}"
    server = uvicorn.Server(
        uvicorn.Config(
            Guard(build_application(session, viewer), number, token),
            log_level="warning",
            ws="websockets-sansio",
            timeout_graceful_shutdown=1,
        )
    )
    print(f"spiral app: {address}   (Ctrl-C ends it; studies are kept in {out})", flush=True)
    try:
        with redirect_file(address) as file:
            if browser:
                threading.Timer(0.8, webbrowser.open, (file.as_uri(),)).start()
            server.run(sockets=[listening])
    except KeyboardInterrupt:
        print("ended", file=sys.stderr)
    finally:
        session.close()
        viewer.close()


@contextmanager
def redirect_file(address: str) -> Iterator[Path]:
    """A file of this user alone that leads a browser to the address with its token.

    What a browser is told to open shows in the list of processes, which all users of a machine see.
    """
    with tempfile.TemporaryDirectory(prefix="spiral-") as folder:  # readable by its owner alone
        file = Path(folder) / "open.html"
        file.write_text(f'<meta http-equiv="refresh" content="0;url={address}">', encoding="utf-8")
        yield file


def build_application(session: Any, viewer: Any) -> Any:
    """The page as an ASGI application."""
    from fastapi import FastAPI
    from nicegui import app, ui

    from spiral.app.address import parse_address
    from spiral.app.downloads import add_download_routes
    from spiral.app.mapping import file_page
    from spiral.app.page import study_page
    from spiral.app.start import start_page
    from spiral.app.upload import add_upload_route

    # No bar at the window's edge for each request: it has no name for a screen reader.
    app.config.quasar_config["loadingBar"]["skipHijack"] = True
    web = FastAPI(openapi_url=None)
    add_download_routes(web, session, viewer)
    add_upload_route(web, session)

    @ui.page("/", title="SPIRAL")
    def _start() -> None:
        start_page(session)

    @ui.page("/study/{ident}", title="SPIRAL")
    def _study(ident: str, turn: str = "", tab: str = "", zoom: str = "", beside: str = "") -> None:
        study_page(session, ident, parse_address(turn, tab, zoom, beside))

    @ui.page("/file/{ident}", title="SPIRAL")
    def _file(ident: str) -> None:
        file_page(session, ident)

    ui.run_with(web, title="SPIRAL", show_welcome_message=False, tailwind=False, dark=None,
                language="en-US", reconnect_timeout=20.0)  # fmt: skip
    return web


def _listening_socket(port: int | None) -> socket.socket:
    """A listening socket on the port asked for; if none was, on the default or any free one."""
    for wanted in (port,) if port is not None else (PORT, 0):
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((HOST, wanted))
            listener.listen(128)  # a browser that comes early waits instead of being refused
        except (OSError, OverflowError):
            listener.close()
            continue
        return listener
    raise ConfigError(f"--port {port}", "a port that is free", "leave it out, or --port 0")
