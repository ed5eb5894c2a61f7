"""What is fetched rather than shown: the report and the model as files, and MLflow's own page."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spiral.app.desk import Desk
from spiral.app.study import Turn
from spiral.app.viewer import Viewer
from spiral.io.storage import own_file, run_folder
from spiral.io.tracking.store import Tracking
from spiral.types.errors import ConfigError, SpiralError

if TYPE_CHECKING:
    from fastapi import FastAPI

REPORT = "report.html"
_TRACKED = re.compile(r"experiments/\w+/runs/\w+", re.ASCII)


def routes(web: FastAPI, desk: Desk, viewer: Viewer) -> None:
    """Add the addresses of files to the application."""
    from fastapi.responses import FileResponse, PlainTextResponse, RedirectResponse

    @web.get("/take/{ident}/{serial}/{name}")
    async def _take(ident: str, serial: int, name: str) -> Any:
        try:
            file = await asyncio.to_thread(written, desk, ident, serial, name)
        except SpiralError as error:
            return PlainTextResponse(str(error), status_code=404)
        return FileResponse(file, filename=f"{file.parent.name}-{name}")

    @web.get("/mlflow/{ident}/{serial}")
    async def _mlflow(ident: str, serial: int) -> Any:
        try:
            turn = _saved(desk, ident, serial)
            if not _TRACKED.fullmatch(turn.tracked):
                raise ConfigError(f"turn {serial}", "a turn that MLflow knows of", "wait a moment")
            store = Tracking().where(desk.out)  # never one that a file of the study names
            address = await asyncio.to_thread(viewer.address, store, turn.tracked)
        except SpiralError as error:
            return PlainTextResponse(str(error), status_code=404)
        return RedirectResponse(address)


def written(desk: Desk, ident: str, serial: int, name: str) -> Path:
    """A turn's report, model or numbers as a file in the folder of its run.

    Raises
    ------
    ConfigError : no such study, turn or file, or a turn that is not saved yet.
    """
    turn = _saved(desk, ident, serial)
    makers = {REPORT: _report, "model.tex": _latex, "model.txt": _equation, "run.json": None}
    if name not in makers:
        raise ConfigError(f"file {name}", f"one of {', '.join(makers)}")
    file = own_file(run_folder(desk.out, turn.run_id), name)
    make = makers[name]
    if make is not None and not file.is_file():
        from spiral.io.storage import write_whole

        write_whole(file, make(desk, turn))
    return file


def _saved(desk: Desk, ident: str, serial: int) -> Turn:
    turn = desk.scene(ident).study.turn_of(serial)
    if turn is None or not turn.run_id:
        raise ConfigError(f"turn {serial}", "a turn that is saved", "wait a moment")
    return turn


def _report(desk: Desk, turn: Turn) -> str:
    from spiral.io.curves import read_curves
    from spiral.io.storage import load_run
    from spiral.view.report.page import page

    saved = load_run(turn.run_id, desk.out)
    return page(saved.data, read_curves(saved.file.parent))[0]


def _latex(desk: Desk, turn: Turn) -> str:
    from spiral.io.export import latex

    return latex(_model(desk, turn)) + "\n"


def _equation(desk: Desk, turn: Turn) -> str:
    from spiral.io.export import equation

    return equation(_model(desk, turn)) + "\n"


def _model(desk: Desk, turn: Turn) -> Any:
    from spiral.io.registry import load_registry
    from spiral.io.storage import load_run

    return load_run(turn.run_id, desk.out).model(load_registry(desk.plugins))
