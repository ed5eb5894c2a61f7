"""The worker process that fits: it fits the seed, ranks candidates, adds effects and refits.

Runs in a process of its own. The steps are the loop's (``spiral.inference.rounds``); between them
the compiled study and the last ranking are kept, so that adding an effect compiles nothing. What a
turn comes to is written into its folder first and told afterwards.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from spiral.app.caveats import (
    indistinguishable_effects,
    tellable_noise_floor,
    turn_caveats,
)
from spiral.app.drawing import FIRST, write_turn_figures
from spiral.app.own_effect import example_formula
from spiral.app.python_text import non_default_options
from spiral.app.study import turn_folder
from spiral.app.trials import (
    draw_benefit_figure,
    keep_latest,
    rank_discriminating_tests,
    trial_details,
)
from spiral.engine.threads import one_blas_thread
from spiral.inference.discover import Checkpoint
from spiral.inference.evidence.assembly import Assembly, initial_values
from spiral.inference.evidence.comparison import chi2_on_windows
from spiral.inference.evidence.enlarge import enlarge, enlarge_for
from spiral.inference.problem import Problem, ScoreMessage
from spiral.inference.rounds import (
    admit_step,
    choose_candidate,
    conclude_study,
    rank_last_round,
    refuse_study,
    start_study,
    strategy_for,
)
from spiral.inference.strategies.base import StartedStudy, Step, Strategy
from spiral.inference.unknown.memory import memory_sentence
from spiral.io.checkpoint import read_checkpoint, write_checkpoint
from spiral.io.compute_curves import free_curves
from spiral.io.curves import FINAL, Curves, add_seed_curves, read_curves, write_curves
from spiral.io.registry import Registry
from spiral.io.writing import replace_nonfinite, to_json, write_whole
from spiral.physics.passivity import implausible_signs
from spiral.types.run import Round, Run, Suggestion

Tell = Callable[[str, Mapping[str, Any]], None]
"""Told what happened: a kind (``progress``, ``turn``, ``scored``, ``ranked``, ``preview``,
``contrast``, ``plan``, ``figures``) and plain data."""

Order = Mapping[str, Any]
"""What to do, in plain data: study, overrides, plugins, serial, and what the step needs."""

STATE, KEYS, FREE, FIGURES = "checkpoint.json", "keys.json", "free", "figures"


@dataclass
class FitWorker:
    """The fitting process; between two orders it keeps the last study in memory."""

    out: Path
    tell: Tell
    ident: str = ""
    problem: Problem | None = None
    registry: Registry | None = None
    strategy: Strategy | None = None
    begun: StartedStudy | None = None
    overrides: tuple[str, ...] = ()
    program: Mapping[str, Any] = field(default_factory=dict)
    ranked: dict[int, tuple[Checkpoint, Step]] = field(default_factory=dict)
    tried: dict[tuple[int, str], Checkpoint] = field(default_factory=dict)
    lacking: dict[int, Any] = field(default_factory=dict)
    config: Any = None

    def describe_file(self, order: Order) -> None:
        """Read a file, and send its columns, their first numbers, and a figure of them."""
        from spiral.app import file_preview

        file_preview.describe_file(order, self.tell)

    def read_equations(self, order: Order) -> None:
        """Read a file of equations, and send the system that it defines."""
        from spiral.app import file_preview

        file_preview.read_equations(order, self.tell)

    def _load_plugins(self, order: Order) -> Registry:
        """Load all plugins anew, and send a message on each file that cannot be used."""
        from spiral.io.registry import load_registry

        registry = load_registry(order.get("plugins"))
        self.tell("broken", {"broken": [f"{f.file}: {f.message}" for f in registry.failures]})
        return registry

    def check(self, order: Order) -> None:
        """Read the records with a mapping, send them and the model, and keep both for the study."""
        from spiral.app.file_preview import compare_reading, describe_model
        from spiral.io.config import build_sources

        self._open_study(order)
        assert self.problem is not None
        assert self.registry is not None
        source = build_sources(self.config, self.registry)[0]
        compare_reading(order, source, self.problem, self.tell)
        self.tell("model", replace_nonfinite(describe_model(self.problem.model, self.registry)))

    @one_blas_thread
    def start(self, order: Order) -> None:
        """Fit the seed, and rank the candidates beside it."""
        began = time.perf_counter()
        self._open_study(order)
        begun = self._begin_strategy()
        at = start_study(begun, time.perf_counter() - began)
        self._save_turn(order, at, "")
        if begun.refused:
            run = refuse_study(begun, at.rounds[0])
            groups = [list(g) for g in begun.groups]
            self.tell("ranked", {**_ranking_data(run, None, ()), "groups": groups, "caveats": []})
            return
        self._rank_turn(order["serial"], at)

    @one_blas_thread
    def add(self, order: Order) -> None:
        """Admit an effect to a turn, refit, and rank what is missing then."""
        self._open_study(order)
        at = self._refit_with(order["base"], order["effect"])
        self._save_turn(order, at, order["effect"])
        self._rank_turn(order["serial"], at)

    @one_blas_thread
    def rank(self, order: Order) -> None:
        """Rank the candidates beside the model of a turn, from its checkpoint."""
        self._open_study(order)
        at, step = self._ranked_turn(order["base"])
        assert self.registry is not None
        folder = turn_folder(self.out, self.ident, order["base"])
        write_checkpoint(at, folder / STATE, self.registry)
        self._tell_ranking(at, step)

    @one_blas_thread
    def invent(self, order: Order) -> None:
        """Rank anew with a candidate more, which the order's overrides define."""
        self._open_study(order)
        at, step = self._ranked_turn(order["base"])
        self._tell_ranking(at, step)

    @one_blas_thread
    def preview(self, order: Order) -> None:
        """The test error with an effect added; the study itself is not changed."""
        self._open_study(order)
        at = self._refit_with(order["base"], order["effect"])
        last, folder = at.rounds[-1], turn_folder(self.out, self.ident, order["base"])
        drawn = False
        with suppress(ArithmeticError, ValueError):  # LinAlgError is a ValueError
            held = enlarge_for(self._assembly(), at.fit_state)
            after = free_curves(held, FINAL, at.fit_state, last.comparison)
            before = read_curves(folder / FREE)
            drawn = draw_benefit_figure(folder / FIGURES, order["effect"], before, after)
        assert self.problem is not None
        base = at.rounds[-2].comparison.model
        more = trial_details(folder / FIGURES, order["effect"], base, last.comparison.model,
                     self.problem.records[0], order["base"], self.lacking)  # fmt: skip
        said = {"effect": order["effect"], "test_error": last.comparison.test_error,
                "changes": [c.as_dict() for c in last.changes], "drawn": drawn, **more}  # fmt: skip
        self.tell("preview", {"preview": replace_nonfinite(said)})

    @one_blas_thread
    def plan(self, order: Order) -> None:
        """Rank the tests that would tell effects apart, from the model of a turn."""
        self._open_study(order)
        at, _ = self._ranked_turn(order["base"])
        assert self.problem is not None
        assert self.registry is not None
        model = at.rounds[-1].comparison.model
        plan_data = rank_discriminating_tests(
            self.problem, model, order["effects"], order["durations"], self.registry,
            self._tell_progress,
        )  # fmt: skip
        self.tell("plan", {"plan": plan_data})

    @one_blas_thread
    def contrast(self, order: Order) -> None:
        """Refit with each of several candidates, and tell their errors side by side.

        Errors are at the same horizons of the same test record, chi2 on windows of one length: the
        longest on which all of them were fitted.
        """
        self._open_study(order)
        after = {e: self._refit_with(order["base"], e) for e in order["effects"]}
        common = min(at.rounds[-1].comparison.horizon for at in after.values())
        rows = []
        for effect, at in after.items():
            last = at.rounds[-1]
            chi2 = last.comparison.chi2_per_dof
            if last.comparison.horizon != common:
                chi2 = chi2_on_windows(
                    enlarge_for(self._assembly(), at.fit_state), at.fit_state, common
                )
            rows.append(
                {
                    **_contrast_figures(last),
                    "effect": effect,
                    "chi2_per_dof": replace_nonfinite(chi2),
                }
            )
        self.tell("contrast", {"rows": rows, "horizon": common})

    def _refit_with(self, base: int, effect: str) -> Checkpoint:
        """A turn with an effect more: refitted, or as it was when it was tried before."""
        if (base, effect) not in self.tried:
            at, step = self._ranked_turn(base)
            began = time.perf_counter()
            self._tell_progress(f"refitting with {effect}")
            step = choose_candidate(self._strategy(), self._assembly(), at, step, effect)
            at = admit_step(self._strategy(), self._assembly(), at, step, self._tell_progress,
                        time.perf_counter() - began)  # fmt: skip
            keep_latest(self.tried, (base, effect), at)
        return self.tried[base, effect]

    def _open_study(self, order: Order) -> None:
        """Read the records and compile, unless this study is at hand."""
        from spiral.io.config import build_problem, compose
        from spiral.io.custom import registry_for_config
        from spiral.types.errors import ConfigError

        overrides = tuple(order["overrides"])
        if self.overrides == overrides and self.ident == order["study"]:
            return
        if self.overrides == overrides and self.problem is not None and self.begun is None:
            self.ident = order["study"]  # a file that was looked at becomes a study
            self._tell_records()
            return
        self.ident, self.overrides, self.begun, self.ranked, self.tried = "", (), None, {}, {}
        self.lacking = {}
        self._tell_progress("reading the record")
        self.registry = self._load_plugins(order)
        config = compose(overrides, self.registry)
        self.registry = registry_for_config(config, self.registry)
        self.config, self.problem = config, build_problem(config, self.registry)
        self.program = non_default_options(config, self.registry)
        self.strategy = strategy_for(self.problem)
        if not self.strategy.by_hand:
            raise ConfigError(f"strategy={self.strategy.plugin_name()} on the page",
                              "a strategy that can admit what a person chooses",
                              "leave strategy out, or use `spiral discover`")  # fmt: skip
        self._tell_records()
        self.ident, self.overrides = order["study"], overrides

    def _tell_records(self) -> None:
        """What was understood of the records, and what a formula may name."""
        from spiral.view.terminal.preview import describe_records

        assert self.problem is not None
        description = {"records": replace_nonfinite(describe_records(self.problem))}
        description |= {
            "example": example_formula(self.problem.model.system),
            "program": self.program,
        }
        self.tell("records", description)

    def _begin_strategy(self) -> StartedStudy:
        if self.begun is None:
            assert self.problem is not None
            self._tell_progress("compiling the model and all candidates")
            self.begun = self._strategy().begin(self.problem, self._tell_progress)
        return self.begun

    def _ranked_turn(self, serial: int) -> tuple[Checkpoint, Step]:
        """A turn with its candidates ranked: from memory, or from disk and ranked again."""
        if serial not in self.ranked:
            assert self.registry is not None
            self._begin_strategy()
            folder = turn_folder(self.out, self.ident, serial)
            at = read_checkpoint(folder / STATE, self.registry)
            at = _align_checkpoint(at, folder, self._assembly())
            ranked_turn = rank_last_round(
                self._strategy(), self._assembly(), at, self._tell_progress
            )
            keep_latest(self.ranked, serial, ranked_turn)
        return self.ranked[serial]

    def _save_turn(self, order: Order, at: Checkpoint, effect: str) -> None:
        """Keep a turn on disk, then tell its figures, then draw."""
        assert self.registry is not None
        serial = order["serial"]
        folder = turn_folder(self.out, self.ident, serial)
        folder.mkdir(parents=True, exist_ok=True)
        write_checkpoint(at, folder / STATE, self.registry)
        held = enlarge_for(self._assembly(), at.fit_state)
        write_whole(folder / KEYS, to_json(list(held.study.keys)))
        last = at.rounds[-1]
        problem = self._assembly().problem
        floor = tellable_noise_floor(last.comparison.floor, problem.test or problem.records)
        self.tell(
            "turn",
            {
                "added": effect,
                "result": _turn_result(last),
                "noise_floor": replace_nonfinite(floor),
            },
        )
        self._tell_progress("drawing")
        alone, both = self._write_free_runs(order, at)
        drawn = write_turn_figures(at, alone, both, folder / FIGURES, lambda name: name in FIRST)
        self.tell("figures", {"figures": drawn})
        drawn += write_turn_figures(
            at, alone, both, folder / FIGURES, lambda name: name not in FIRST
        )
        self.tell("figures", {"figures": drawn})

    def _write_free_runs(self, order: Order, at: Checkpoint) -> tuple[Curves | None, Curves | None]:
        """Free runs of this turn, and the same beside those of the first."""
        place = turn_folder(self.out, self.ident, order["serial"]) / FREE
        place.mkdir(exist_ok=True)
        try:
            held = enlarge_for(self._assembly(), at.fit_state)
            curves = free_curves(held, FINAL, at.fit_state, at.rounds[-1].comparison)
            write_curves(curves, place)
        except (ArithmeticError, ValueError) as error:  # LinAlgError is a ValueError
            self._tell_progress(f"no curves: {error}")
            return None, None
        if len(at.rounds) == 1:
            return curves, None
        first = read_curves(turn_folder(self.out, self.ident, order["first"]) / FREE)
        return curves, None if first is None else add_seed_curves(first, curves)

    def _rank_turn(self, serial: int, at: Checkpoint) -> None:
        self._tell_progress("ranking what may be missing")
        at, step = rank_last_round(self._strategy(), self._assembly(), at, self._tell_progress)
        keep_latest(self.ranked, serial, (at, step))
        assert self.registry is not None
        write_checkpoint(at, turn_folder(self.out, self.ident, serial) / STATE, self.registry)
        self._tell_ranking(at, step)

    def _tell_ranking(self, at: Checkpoint, step: Step) -> None:
        settings = self._assembly().problem.settings
        stopped = "max_rounds" if step.admitted else step.stopped
        run = conclude_study(at, stopped, settings)
        ranked = _ranking_data(run, step, tuple(_candidate_rows(self._strategy().ranked(step))))
        told = {"caveats": turn_caveats(at, settings), "alike": indistinguishable_effects(at)}
        self.tell("ranked", {**ranked, **told})

    def _strategy(self) -> Strategy:
        assert self.strategy is not None
        return self.strategy

    def _assembly(self) -> Assembly:
        return self._begin_strategy().assembly

    def _tell_progress(self, words: str) -> None:
        self.tell("progress", {"words": str(words)})
        if isinstance(words, ScoreMessage):
            self.tell("scored", {"candidates": _candidate_rows(words.suggestions)})


def _align_checkpoint(at: Checkpoint, folder: Path, assembly: Assembly) -> Checkpoint:
    """A checkpoint with its values in the columns of this compilation, matched by parameter name.

    A candidate that was added since shifts the columns of the others; its own get start values.
    """
    try:
        before = json.loads((folder / KEYS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return at
    assembly = enlarge(assembly, at.fit_state.labels)
    keys, old = list(assembly.study.keys), at.fit_state.values
    if before == keys:
        return at
    values = initial_values(assembly)
    for column, key in enumerate(before):
        if key in keys:
            values[:, keys.index(key)] = old[:, column]
    values[:, len(keys) :] = old[:, len(before) :]
    return Checkpoint(at.rounds, replace(at.fit_state, values=values))


def _turn_result(fitted_round: Round) -> dict[str, Any]:
    data = {k: v for k, v in fitted_round.as_dict().items() if k not in ("suggestions", "details")}
    channels = {k: v.as_dict() for k, v in fitted_round.comparison.channels.items()}
    signs = implausible_signs(fitted_round.comparison.model)
    told = {"channels": channels, "converged": fitted_round.comparison.converged, "signs": signs}
    return replace_nonfinite({**data, **told})


def _contrast_figures(fitted_round: Round) -> dict[str, Any]:
    kept = ("fit_error", "test_error", "chi2_per_dof", "unseen")
    return replace_nonfinite({k: v for k, v in fitted_round.as_dict().items() if k in kept})


def _candidate_rows(suggestions: Sequence[Suggestion]) -> list[dict[str, Any]]:
    rows = []
    for suggestion in suggestions:
        row = {**suggestion.as_dict(), "hint": list(suggestion.hint)}
        rows.append(replace_nonfinite(row))
    return rows


def _ranking_data(run: Run, step: Step | None, candidates: tuple[Any, ...]) -> dict[str, Any]:
    return {
        "candidates": list(candidates),
        "proposed": list(step.admitted) if step else [],
        "rejected": dict(step.rejected) if step else {},
        "verdict": run.verdict if step is None or step.admitted else step.stopped,
        "advice": run.advice,
        "shape": (run.rounds[-1].details.get("unknown") or {}).get("sentence", ""),
        "memory": memory_sentence(run.rounds),
    }
