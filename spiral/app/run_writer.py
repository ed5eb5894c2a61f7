"""The worker process that finishes a turn: where the model fails, the saved run, MLflow, report.

The page does not wait for any of it. Every turn becomes a saved run as the command line saves one,
so that ``spiral report run=ID`` and ``spiral add ... run=ID`` take it up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from spiral.app.drawing import write_turn_figures
from spiral.app.fit_worker import FIGURES, STATE, Order, Tell
from spiral.app.study import turn_folder
from spiral.inference.problem import Problem
from spiral.inference.rounds import Checkpoint, conclude_study
from spiral.io.checkpoint import read_checkpoint
from spiral.io.compute_curves import gather_curves
from spiral.io.curves import FINAL, SEED, Curves, drop_seed_curves, write_curves
from spiral.io.registry import Registry
from spiral.io.storage import save_result
from spiral.types.run import Run

_BY_HAND = "The effects were added by hand."


@dataclass
class RunWriter:
    """The writer process; between two orders it keeps the records of the last study."""

    out: Path
    tell: Tell
    ident: str = ""
    problem: Problem | None = None
    registry: Registry | None = None
    config: Mapping[str, Any] | None = None

    def write(self, order: Order) -> None:
        """Maps and missing force of a turn, its saved run, and MLflow's."""
        self._load_problem(order)
        assert self.registry is not None
        folder = turn_folder(self.out, order["study"], order["serial"])
        at = read_checkpoint(folder / STATE, self.registry)
        curves = self._gather_curves(at)
        if curves is not None:
            drawn = write_turn_figures(at, drop_seed_curves(curves), curves, folder / FIGURES)
            sentence = curves.meta["models"][FINAL].get("where", {}).get("sentence", "")
            equation = curves.meta["mathml"]
            self.tell("figures", {"figures": drawn, "sentence": sentence, "equation": equation})
        run_id = self._save_run(at, order, curves)
        self.tell("saved", {"run_id": run_id})
        self.tell("tracked", self._track(run_id))

    def foresee(self, order: Order) -> None:
        """Whether the records can tell the model's effects and all candidates apart."""
        from spiral.app.identifiability import identifiability_forecast

        self._load_problem(order)
        assert self.problem is not None
        assert self.config is not None
        assert self.registry is not None
        self.tell("foresight", identifiability_forecast(self.problem, self.config, self.registry))

    def _load_problem(self, order: Order) -> None:
        from spiral.io.config import build_problem, compose
        from spiral.io.custom import registry_for_config
        from spiral.io.registry import load_registry

        wanted = f"{order['study']} {order['overrides']}"
        if self.ident == wanted:
            return
        self.ident = ""
        self.registry = load_registry(order.get("plugins"))
        self.config = compose(order["overrides"], self.registry)
        self.registry = registry_for_config(self.config, self.registry)
        self.problem = build_problem(self.config, self.registry)
        self.ident = wanted

    def _gather_curves(self, at: Checkpoint) -> Curves | None:
        assert self.problem is not None
        models = {FINAL: at.rounds[-1].comparison}
        if len(at.rounds) > 1:
            models = {SEED: at.rounds[0].comparison, **models}
        try:
            return gather_curves(self.problem, models)
        except (ArithmeticError, ValueError):  # LinAlgError is a ValueError
            return None

    def _save_run(self, at: Checkpoint, order: Order, curves: Curves | None) -> str:
        assert self.problem is not None
        assert self.registry is not None
        assert self.config is not None
        run = _run_up_to_turn(at, self.problem)
        verb = "add" if len(at.rounds) > 1 else "diagnose"
        data = {"records": self.problem.records, "test": self.problem.test}
        config = {**self.config, "out": str(self.out)}
        run_id = save_result(
            verb, run.as_dict(), run.model, config, data, self.registry, self.out,
            order["overrides"],
        )  # fmt: skip
        if curves is not None:
            write_curves(curves, self.out / run_id)
        return run_id

    def _track(self, run_id: str) -> dict[str, Any]:
        """MLflow's id of the run, or why it does not know of it.

        The tracking server is the one the page was started with, whatever the study's file says.
        """
        from spiral.io.tracking.store import tracking_options
        from spiral.io.tracking.track import track
        from spiral.view.report.html import report_html

        assert self.config is not None
        tracking = track(replace(tracking_options(self.config), uri=None), self.out, (run_id,),
                      catch_up=False, draw=report_html, registry=self.registry)  # fmt: skip
        number = tracking.runs.get(run_id)
        place = f"experiments/{tracking.experiment}/runs/{number}" if number else ""
        return {"tracked": place, "untracked": tracking.failure or ""}


def _run_up_to_turn(at: Checkpoint, problem: Problem) -> Run:
    """The history up to this turn; its advice names what was added by hand."""
    run = conclude_study(at, "max_rounds", problem.settings, _BY_HAND)
    first = at.rounds[0]
    if len(at.rounds) > 1:
        return run
    best = next(iter(first.suggestions), None)
    advice = f"Add {best.effect}: {best.meaning}" if best is not None else ""
    return replace(run, advice=advice)
