"""Files from the browser: streamed to disk as they come, never held in memory, limited in size."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

from spiral.app import record_setup as setups
from spiral.app.session import Session
from spiral.types.errors import ConfigError, InputError

if TYPE_CHECKING:
    from fastapi import FastAPI

MOST = 10**9  # bytes
_BLOCK = 1 << 20


def too_large_error(size: int | None) -> InputError:
    """The message for a file over the limit."""
    said = f"a file of {size / 1e9:.3g} GB" if size else "a file over the limit"
    return InputError(
        said, f"at most {MOST / 1e9:.3g} GB from the browser",
        "type its path below instead: it is then read where it lies; or keep the columns you need",
    )  # fmt: skip


def add_upload_route(web: FastAPI, session: Session) -> None:
    """Add ``POST /upload`` to the application: the body is the file, ``x-file-name`` its name.

    ``x-file-beside`` names the setup of another file of the same machine, where there is one.
    """
    from fastapi.responses import JSONResponse

    async def receive_upload(request: Any) -> Any:
        size = request.headers.get("content-length", "")
        try:
            ident = await receive_file(
                session, unquote(request.headers.get("x-file-name", "record")),
                int(size) if size.isdigit() else None, request.stream(),
                request.headers.get("x-file-beside", ""),
            )  # fmt: skip
        except (InputError, ConfigError) as error:
            large = "over" in str(error) or " GB" in error.given
            return JSONResponse({"error": error.as_dict()}, status_code=413 if large else 400)
        return JSONResponse({"page": f"/file/{ident}"})

    web.add_route("/upload", receive_upload, methods=["POST"])


async def receive_file(
    session: Session, name: str, size: int | None, stream: AsyncIterator[bytes], beside: str = ""
) -> str:
    """Write a stream to disk and have it read; returns the setup's name.

    Raises
    ------
    InputError : too large, empty, broken off, or a disk that takes no more. Nothing is left then.
    ConfigError : no setup of the name ``beside``.
    """
    if size is not None and size > MOST:
        raise too_large_error(size)
    files = session.file_setup
    setup = None if beside else files.create_setup(name)
    file = files.free_file_path(beside, name) if setup is None else Path(setup.path)
    try:
        written = await _write_stream(file, stream)
        if not written:
            raise InputError(f"{name}: an empty file", "a file with rows of numbers")
        if size is not None and written != size:
            raise InputError(f"{name}: the upload broke off", "the whole file", "drop it again")
    except BaseException:
        file.unlink(missing_ok=True)
        if setup is not None:
            files.discard_setup(setup)
        raise
    if setup is None:
        files.join_file(beside, file, setups.safe_file_name(name))
        return beside
    files.read_arrived_file(setup)
    return setup.ident


async def _write_stream(file: Path, stream: AsyncIterator[bytes]) -> int:
    """Number of bytes that came; the disk is written by another thread."""
    written, block = 0, bytearray()
    try:
        with file.open("wb") as target:
            async for part in stream:
                written += len(part)
                if written > MOST:
                    raise too_large_error(None)
                block += part
                if len(block) >= _BLOCK:
                    await asyncio.to_thread(target.write, bytes(block))
                    block.clear()
            await asyncio.to_thread(target.write, bytes(block))
    except OSError as error:
        raise InputError(
            f"{file.name}: {error.strerror or error}",
            "room on the disk",
            "free some, and try again",
        ) from error
    return written
