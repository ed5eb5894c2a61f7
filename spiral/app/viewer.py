"""A server of MLflow's own page on the tracked runs, started when it is first opened."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time

from spiral.types.errors import InputError
from spiral.types.masking import without_passwords

_PATIENCE = 90.0  # s until its page answers
HOST, STORE_VARIABLE = "127.0.0.1", "MLFLOW_BACKEND_STORE_URI"


class Viewer:
    """At most one MLflow server, of this machine alone, ended with the page."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._server: subprocess.Popen[bytes] | None = None
        self._address, self._store = "", ""

    def address(self, store: str, place: str) -> str:
        """Where MLflow shows a run: on its own server, or on one started here.

        Raises
        ------
        InputError : a server that does not start.
        """
        if store.startswith("http"):
            return f"{store.rstrip('/')}/#/{place}"
        with self._lock:
            running = self._server is not None and self._server.poll() is None
            if not running or self._store != store:
                self.close()
                self._start_server(store)
        return f"{self._address}/#/{place}"

    def close(self) -> None:
        """End the server."""
        if self._server is not None:
            self._server.terminate()
        self._server = None

    def _start_server(self, store: str) -> None:
        with socket.socket() as free:
            free.bind((HOST, 0))
            port = free.getsockname()[1]
        command = [sys.executable, "-m", "mlflow", "server",
                   "--host", HOST, "--port", str(port), "--workers", "1"]  # fmt: skip
        # The address may hold a password, and the list of processes shows command lines to all.
        quiet = {**os.environ, "MLFLOW_DISABLE_TELEMETRY": "true", STORE_VARIABLE: store,
                 "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}  # fmt: skip
        self._server = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=quiet
        )
        self._address, self._store = f"http://{HOST}:{port}", store
        until = time.monotonic() + _PATIENCE
        while time.monotonic() < until and self._server.poll() is None:
            with socket.socket() as trial:
                trial.settimeout(0.5)
                if trial.connect_ex((HOST, port)) == 0:
                    return
            time.sleep(0.2)
        self.close()
        raise InputError(
            "MLflow's page does not start", "a server", f"mlflow ui on {without_passwords(store)}"
        )
