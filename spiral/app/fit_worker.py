"""The steps of a study with everything in memory: fit the seed, rank, admit, refit.

Runs in a process of its own. The steps are the loop's (``spiral.inference.rounds``); between them
the compiled study and the last ranking are kept, so that adding an effect compiles nothing. What a
turn comes to is written into its folder first and told afterwards.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from spiral.app.caveats import alike, caveats
from spiral.app.drawing import FIRST, draw
from spiral.app.own_effect import example
from spiral.app.python_text import asked
from spiral.app.side_steps import drawn_why, keep, planned, tried
from spiral.app.study import turn_place
from spiral.engine.threads import one_blas_thread
from spiral.inference.discover import Checkpoint
from spiral.inference.evidence.assembly import Assembly, first_row
from spiral.inference.evidence.comparison import chi2_on
from spiral.inference.problem import Problem
from spiral.inference.rounds import (
    chosen,
    concluded,
    looked,
    refused,
    started,
    strategy_for,
    turned,
)
from spiral.inference.strategies.base import Begun, Step, Strategy
from spiral.inference.unknown.holding import having, holding
from spiral.inference.unknown.memory import memory_said
from spiral.io.checkpoint import read_checkpoint, write_checkpoint
from spiral.io.curves import FINAL, Curves, beside, read_curves, write_curves
from spiral.io.gather import free_curves
from spiral.io.registry import Registry
from spiral.io.writing import finite, to_json, write_whole
from spiral.physics.passivity import implausible
from spiral.types.run import Round, Run

Tell = Callable[[str, Mapping[str, Any]], None]
"""Told what happened: a kind (``progress``, ``turn``, ``ranked``, ``preview``, ``contrast``,
``plan``, ``figures``) and plain data."""

Order = Mapping[str, Any]
"""What to do, in plain data: study, overrides, plugins, serial, and what the step needs."""

STATE, KEYS, FREE, FIGURES = "checkpoint.json", "keys.json", "free", "figures"


@dataclass
class FitWorker:
    """What one process keeps between two orders: the study last worked on."""

    out: Path
    tell: Tell
    ident: str = ""
    problem: Problem | None = None
    registry: Registry | None = None
    strategy: Strategy | None = None
    begun: Begun | None = None
    overrides: tuple[str, ...] = ()
    program: Mapping[str, Any] = field(default_factory=dict)
    standing: dict[int, tuple[Checkpoint, Step]] = field(default_factory=dict)
    tried: dict[tuple[int, str], Checkpoint] = field(default_factory=dict)
    lacking: dict[int, Any] = field(default_factory=dict)
    config: Any = None

    def describe_file(self, order: Order) -> None:
        """What is in a file: its columns, their first numbers, and a picture of them."""
        from spiral.app import file_preview

        file_preview.describe_file(order, self.tell)

    def read_equations(self, order: Order) -> None:
        """The system that a text of equations makes."""
        from spiral.app import file_preview

        file_preview.read_equations(order, self.tell)

    def _loaded(self, order: Order) -> Registry:
        """All plugins as they are now; files that cannot be used are told."""
        from spiral.io.registry import load_registry

        found = load_registry(order.get("plugins"))
        self.tell("broken", {"broken": [f"{f.file}: {f.message}" for f in found.failures]})
        return found

    def check(self, order: Order) -> None:
        """What a mapping makes of a file; the records are kept for the study that may follow."""
        from spiral.app.file_preview import compare_reading, described_model
        from spiral.io.config import build_sources

        self._open(order)
        assert self.problem is not None
        assert self.registry is not None
        source = build_sources(self.config, self.registry)[0]
        compare_reading(order, source, self.problem, self.tell)
        self.tell("model", finite(described_model(self.problem.model)))

    @one_blas_thread
    def start(self, order: Order) -> None:
        """Fit the seed, and rank what it lacks."""
        began = time.perf_counter()
        self._open(order)
        begun = self._begun()
        at = started(begun, time.perf_counter() - began)
        self._arrived(order, at, "")
        if begun.refused:
            run = refused(begun, at.rounds[0])
            groups = [list(g) for g in begun.groups]
            self.tell("ranked", {**_ranked(run, None, ()), "groups": groups, "caveats": []})
            return
        self._look(order["serial"], at)

    @one_blas_thread
    def add(self, order: Order) -> None:
        """Admit an effect to a turn, refit, and rank what is missing then."""
        self._open(order)
        at = self._with(order["base"], order["effect"])
        self._arrived(order, at, order["effect"])
        self._look(order["serial"], at)

    @one_blas_thread
    def rank(self, order: Order) -> None:
        """Rank what a turn lacks, from its checkpoint."""
        self._open(order)
        at, step = self._ready(order["base"])
        assert self.registry is not None
        folder = turn_place(self.out, self.ident, order["base"])
        write_checkpoint(at, folder / STATE, self.registry)
        self._told(at, step)

    @one_blas_thread
    def invent(self, order: Order) -> None:
        """Rank anew with a candidate more, which the order's overrides define."""
        self._open(order)
        at, step = self._ready(order["base"])
        self._told(at, step)

    @one_blas_thread
    def preview(self, order: Order) -> None:
        """What adding an effect would come to on the test record; the study stays as it is."""
        self._open(order)
        at = self._with(order["base"], order["effect"])
        last, folder = at.rounds[-1], turn_place(self.out, self.ident, order["base"])
        drawn = False
        with suppress(ArithmeticError, ValueError):  # LinAlgError is a ValueError
            held = holding(self._assembly(), at.standing)
            after = free_curves(held, FINAL, at.standing, last.comparison)
            before = read_curves(folder / FREE)
            drawn = drawn_why(folder / FIGURES, order["effect"], before, after)
        assert self.problem is not None
        base = at.rounds[-2].comparison.model
        more = tried(folder / FIGURES, order["effect"], base, last.comparison.model,
                     self.problem.records[0], order["base"], self.lacking)  # fmt: skip
        said = {"effect": order["effect"], "test_error": last.comparison.test_error,
                "changes": [c.as_dict() for c in last.changes], "drawn": drawn, **more}  # fmt: skip
        self.tell("preview", {"preview": finite(said)})

    @one_blas_thread
    def plan(self, order: Order) -> None:
        """Rank the tests that would tell effects apart, from the model of a turn."""
        self._open(order)
        at, _ = self._ready(order["base"])
        assert self.problem is not None
        assert self.registry is not None
        model = at.rounds[-1].comparison.model
        found = planned(self.problem, model, order["effects"], self.registry, self._progress)
        self.tell("plan", {"plan": found})

    @one_blas_thread
    def contrast(self, order: Order) -> None:
        """Refit with each of several candidates, and tell their errors side by side.

        Errors are at the same horizons of the same test record, chi2 on windows of one length: the
        longest on which all of them were fitted.
        """
        self._open(order)
        after = {e: self._with(order["base"], e) for e in order["effects"]}
        common = min(at.rounds[-1].comparison.horizon for at in after.values())
        rows = []
        for effect, at in after.items():
            found = at.rounds[-1]
            chi2 = found.comparison.chi2_per_dof
            if found.comparison.horizon != common:
                chi2 = chi2_on(holding(self._assembly(), at.standing), at.standing, common)
            rows.append({**_figures_of(found), "effect": effect, "chi2_per_dof": finite(chi2)})
        self.tell("contrast", {"rows": rows, "horizon": common})

    def _with(self, base: int, effect: str) -> Checkpoint:
        """A turn with an effect more: refitted, or as it was when it was tried before."""
        if (base, effect) not in self.tried:
            at, step = self._ready(base)
            began = time.perf_counter()
            self._progress(f"refitting with {effect}")
            step = chosen(self._strategy(), self._assembly(), at, step, effect)
            at = turned(self._strategy(), self._assembly(), at, step, self._progress,
                        time.perf_counter() - began)  # fmt: skip
            keep(self.tried, (base, effect), at)
        return self.tried[base, effect]

    def _open(self, order: Order) -> None:
        """Read the records and compile, unless this study is at hand."""
        from spiral.io.config import build_problem, compose
        from spiral.io.custom import bound
        from spiral.types.errors import ConfigError

        overrides = tuple(order["overrides"])
        if self.overrides == overrides and self.ident == order["study"]:
            return
        if self.overrides == overrides and self.problem is not None and self.begun is None:
            self.ident = order["study"]  # a file that was looked at becomes a study
            self._tell_records()
            return
        self.ident, self.overrides, self.begun, self.standing, self.tried = "", (), None, {}, {}
        self.lacking = {}
        self._progress("reading the record")
        self.registry = self._loaded(order)
        config = compose(overrides, self.registry)
        self.registry = bound(config, self.registry)
        self.config, self.problem = config, build_problem(config, self.registry)
        self.program = asked(config, self.registry)
        self.strategy = strategy_for(self.problem)
        if not self.strategy.by_hand:
            raise ConfigError(f"strategy={self.strategy.plugin_name()} on the page",
                              "a strategy that can admit what a person chooses",
                              "leave strategy out, or use `spiral discover`")  # fmt: skip
        self._tell_records()
        self.ident, self.overrides = order["study"], overrides

    def _tell_records(self) -> None:
        """What was understood of the records, and what a formula may name."""
        from spiral.view.terminal.preview import described

        assert self.problem is not None
        found = {"records": finite(described(self.problem))}
        found |= {"example": example(self.problem.model.system), "program": self.program}
        self.tell("records", found)

    def _begun(self) -> Begun:
        if self.begun is None:
            assert self.problem is not None
            self._progress("compiling the model and all candidates")
            self.begun = self._strategy().begin(self.problem, self._progress)
        return self.begun

    def _ready(self, serial: int) -> tuple[Checkpoint, Step]:
        """A turn with its candidates ranked: from memory, or from disk and ranked again."""
        if serial not in self.standing:
            assert self.registry is not None
            self._begun()
            folder = turn_place(self.out, self.ident, serial)
            at = read_checkpoint(folder / STATE, self.registry)
            at = _placed(at, folder, self._assembly())
            found = looked(self._strategy(), self._assembly(), at, self._progress)
            keep(self.standing, serial, found)
        return self.standing[serial]

    def _arrived(self, order: Order, at: Checkpoint, effect: str) -> None:
        """Keep a turn on disk, then tell its figures, then draw."""
        assert self.registry is not None
        serial = order["serial"]
        folder = turn_place(self.out, self.ident, serial)
        folder.mkdir(parents=True, exist_ok=True)
        write_checkpoint(at, folder / STATE, self.registry)
        held = holding(self._assembly(), at.standing)
        write_whole(folder / KEYS, to_json(list(held.study.keys)))
        last = at.rounds[-1]
        floor = last.comparison.noise_floor
        self.tell("turn", {"added": effect, "result": _result(last), "noise_floor": finite(floor)})
        self._progress("drawing")
        alone, both = self._curves(order, at)
        drawn = draw(at, alone, both, folder / FIGURES, lambda name: name in FIRST)
        self.tell("figures", {"figures": drawn})
        drawn += draw(at, alone, both, folder / FIGURES, lambda name: name not in FIRST)
        self.tell("figures", {"figures": drawn})

    def _curves(self, order: Order, at: Checkpoint) -> tuple[Curves | None, Curves | None]:
        """Free runs of this turn, and the same beside those of the first."""
        place = turn_place(self.out, self.ident, order["serial"]) / FREE
        place.mkdir(exist_ok=True)
        try:
            held = holding(self._assembly(), at.standing)
            found = free_curves(held, FINAL, at.standing, at.rounds[-1].comparison)
            write_curves(found, place)
        except (ArithmeticError, ValueError) as error:  # LinAlgError is a ValueError
            self._progress(f"no curves: {error}")
            return None, None
        if len(at.rounds) == 1:
            return found, None
        first = read_curves(turn_place(self.out, self.ident, order["first"]) / FREE)
        return found, None if first is None else beside(first, found)

    def _look(self, serial: int, at: Checkpoint) -> None:
        self._progress("ranking what may be missing")
        at, step = looked(self._strategy(), self._assembly(), at, self._progress)
        keep(self.standing, serial, (at, step))
        assert self.registry is not None
        write_checkpoint(at, turn_place(self.out, self.ident, serial) / STATE, self.registry)
        self._told(at, step)

    def _told(self, at: Checkpoint, step: Step) -> None:
        settings = self._assembly().problem.settings
        stopped = "max_rounds" if step.admitted else step.stopped
        run = concluded(at, stopped, settings)
        ranked = _ranked(run, step, tuple(_candidates(self._strategy(), step)))
        told = {"caveats": caveats(at, settings), "alike": alike(at)}
        self.tell("ranked", {**ranked, **told})

    def _strategy(self) -> Strategy:
        assert self.strategy is not None
        return self.strategy

    def _assembly(self) -> Assembly:
        return self._begun().assembly

    def _progress(self, words: str) -> None:
        self.tell("progress", {"words": words})


def _placed(at: Checkpoint, folder: Path, assembly: Assembly) -> Checkpoint:
    """A checkpoint whose values stand where this compilation has them.

    A candidate written since moves the columns of the others; those it brings begin as before any
    fit.
    """
    try:
        before = json.loads((folder / KEYS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return at
    assembly = having(assembly, at.standing.labels)
    keys, old = list(assembly.study.keys), at.standing.values
    if before == keys:
        return at
    values = first_row(assembly)
    for column, key in enumerate(before):
        if key in keys:
            values[:, keys.index(key)] = old[:, column]
    values[:, len(keys) :] = old[:, len(before) :]
    return Checkpoint(at.rounds, replace(at.standing, values=values))


def _result(found: Round) -> dict[str, Any]:
    data = {k: v for k, v in found.as_dict().items() if k not in ("suggestions", "details")}
    channels = {k: v.as_dict() for k, v in found.comparison.channels.items()}
    signs = implausible(found.comparison.model)
    told = {"channels": channels, "converged": found.comparison.converged, "signs": signs}
    return finite({**data, **told})


def _figures_of(found: Round) -> dict[str, Any]:
    kept = ("fit_error", "test_error", "chi2_per_dof", "unseen")
    return finite({k: v for k, v in found.as_dict().items() if k in kept})


def _candidates(strategy: Strategy, step: Step) -> list[dict[str, Any]]:
    rows = []
    for found in strategy.ranked(step):
        row = {**found.as_dict(), "hint": list(found.hint)}
        rows.append(finite(row))
    return rows


def _ranked(run: Run, step: Step | None, found: tuple[Any, ...]) -> dict[str, Any]:
    return {
        "candidates": list(found),
        "proposed": list(step.admitted) if step else [],
        "rejected": dict(step.rejected) if step else {},
        "verdict": run.verdict if step is None or step.admitted else step.stopped,
        "advice": run.advice,
        "shape": (run.rounds[-1].details.get("unknown") or {}).get("sentence", ""),
        "memory": memory_said(run.rounds),
    }
