"""Downloads of the page (report, model, numbers, study), and the link to MLflow's own page."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from spiral.app.record_setup import safe_file_name
from spiral.app.session import Session
from spiral.app.study import StudyState
from spiral.app.study_archive import write_archive
from spiral.app.viewer import Viewer
from spiral.io.export.kinds import KINDS, export
from spiral.io.storage import resolve_inside_folder, run_folder
from spiral.io.tracking.store import Tracking
from spiral.types.errors import ConfigError, SpiralError
from spiral.view.report.pictures import write_pdf

if TYPE_CHECKING:
    from fastapi import FastAPI

REPORT, PRINTED = "report.html", "report.pdf"
_TRACKED = re.compile(r"experiments/\w+/runs/\w+", re.ASCII)


def add_download_routes(web: FastAPI, session: Session, viewer: Viewer) -> None:
    """Add the addresses of files to the application."""
    from fastapi.responses import FileResponse, PlainTextResponse, RedirectResponse

    @web.get("/take/{ident}/{serial}/{name}")
    async def _send_download(ident: str, serial: int, name: str) -> Any:
        try:
            file = await asyncio.to_thread(write_download, session, ident, serial, name)
        except SpiralError as error:
            return PlainTextResponse(str(error), status_code=404)
        return FileResponse(file, filename=f"{file.parent.name}-{name}")

    @web.get("/whole/{ident}")
    async def _send_archive(ident: str) -> Any:
        try:
            study = session.scene(ident).study
            file = await asyncio.to_thread(write_archive, session.out, study)
        except SpiralError as error:
            return PlainTextResponse(str(error), status_code=404)
        return FileResponse(file, filename=f"{safe_file_name(study.title)}.zip")

    @web.get("/mlflow/{ident}/{serial}")
    async def _redirect_to_mlflow(ident: str, serial: int) -> Any:
        try:
            turn = _saved_turn(session, ident, serial)
            if not _TRACKED.fullmatch(turn.tracked):
                raise ConfigError(f"turn {serial}", "a turn that MLflow knows of", "wait a moment")
            store = Tracking().resolve_uri(session.out)  # never one that a file of the study names
            view = mlflow_chart_path(_tracked_runs(session, ident, turn))
            address = await asyncio.to_thread(viewer.address, store, view)
        except SpiralError as error:
            return PlainTextResponse(str(error), status_code=404)
        return RedirectResponse(address)


def write_download(session: Session, ident: str, serial: int, name: str) -> Path:
    """A turn's report, model or numbers as a file in the folder of its run.

    Raises
    ------
    ConfigError : no such study, turn or file, or a turn that is not saved yet.
    """
    turn = _saved_turn(session, ident, serial)
    exports = {f"model{kind.suffix}": to for to, kind in KINDS.items()}
    known = (REPORT, PRINTED, *exports, "run.json")
    if name not in known:
        raise ConfigError(f"file {name}", f"one of {', '.join(known)}")
    file = resolve_inside_folder(run_folder(session.out, turn.run_id), name)
    # Anew each time: a folder from elsewhere may hold a program, or a page, of that name.
    if name in exports:
        return export(_saved_model(session, turn), exports[name], file, f"run {turn.run_id}")
    if name == REPORT:
        from spiral.io.writing import write_whole

        write_whole(file, _report_page(session, turn))
    if name == PRINTED:
        return write_pdf(_report_page(session, turn), file)
    return file


def _tracked_runs(session: Session, ident: str, turn: StudyState) -> list[str]:
    """MLflow's places of a turn's run and of the ends of the study's other branches."""
    study = session.scene(ident).study
    others = [t.tracked for t in study.turns if not study.after(t.serial)]
    return list(dict.fromkeys(p for p in (turn.tracked, *others) if _TRACKED.fullmatch(p)))


def mlflow_chart_path(places: Sequence[str]) -> str:
    """MLflow's chart of runs: their errors on unseen data over the rounds, logarithmic.

    ``places`` are ``experiments/NUMBER/runs/ID``. Each run holds all its rounds, so that the ends
    of the branches are all there is to compare.
    """
    parts = [p.split("/") for p in places]
    given = {
        "runs": [p[3] for p in parts],
        "metric": "test_error",
        "experiments": sorted({p[1] for p in parts}),
        "plot_metric_keys": ["test_error", "fit_error"],
        "plot_layout": {"autosize": True, "yaxis": {"type": "log"}},
        "line_smoothness": 1,
        "show_point": True,
        "deselected_curves": [],
        "last_linear_y_axis_range": [],
    }
    said = "&".join(f"{k}={quote(json.dumps(v))}" for k, v in given.items())
    return f"metric?{said}&x_axis=step&y_axis_scale=log"


def _saved_turn(session: Session, ident: str, serial: int) -> StudyState:
    turn = session.scene(ident).study.turn_of(serial)
    if turn is None or not turn.run_id:
        raise ConfigError(f"turn {serial}", "a turn that is saved", "wait a moment")
    return turn


def _report_page(session: Session, turn: StudyState) -> str:
    from spiral.io.curves import read_curves
    from spiral.io.storage import load_run
    from spiral.view.report.html import report_page

    saved = load_run(turn.run_id, session.out)
    return report_page(saved.data, read_curves(saved.file.parent))[0]


def _saved_model(session: Session, turn: StudyState) -> Any:
    from spiral.io.registry import load_registry
    from spiral.io.storage import load_run

    saved, registry = load_run(turn.run_id, session.out), load_registry(session.plugins)
    saved.local_files(registry)  # refused where a plugin is not the one that the run recorded
    return saved.model(registry)
