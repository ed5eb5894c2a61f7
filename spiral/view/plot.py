"""Figures of a run, each a Plotly figure: ``spiral.plot.error_falling(run)``.

They are the figures of the report and the page, drawn from the same numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from spiral.types.model import Model
from spiral.types.run import Run, estimate_rows, require_run

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from spiral.io.curves import Curves


def error_falling(run: Run) -> go.Figure | None:
    """Fit and test error over the rounds, with the noise floor; nothing where nothing was added."""
    from spiral.view.report import evidence

    return evidence.error_falling(_finite_result(run))


def candidates(run: Run) -> go.Figure | None:
    """What each candidate would explain, round by round."""
    from spiral.view.report import evidence

    return evidence.candidates(_finite_result(run))


def coefficients(run: Run) -> go.Figure | None:
    """Every coefficient of the final model with its interval."""
    from spiral.view.report import evidence

    return evidence.coefficients(estimate_rows(_finite_result(run)))


def unknown(run: Run) -> go.Figure | None:
    """The learned curve of a force that no candidate explains; nothing where there is none."""
    from spiral.view.report import unknown as shape

    return shape.force_curves(_finite_result(run))


def memory(run: Run) -> go.Figure | None:
    """The loop of a missing force that has memory; nothing where the run found none."""
    from spiral.view.report import unknown as shape

    return shape.force_loops(_finite_result(run))


@dataclass(frozen=True)
class Drawing:
    """A picture as SVG, which a notebook shows."""

    svg: str

    def _repr_svg_(self) -> str:
        return self.svg


def sketch(of: Run | Model) -> Drawing:
    """A sketch of a model, or of a run's final one: its states, couplings and effects."""
    from spiral.physics.couplings import couplings_of
    from spiral.view.report.sketch import sketch as drawn

    return Drawing(drawn(asdict(couplings_of(of.model if isinstance(of, Run) else of))))


def measured(run: Run) -> go.Figure | None:
    """Measured against model: the final model's free run beside the test record.

    The measured curve is the record's raw channel, with the readings that the fit leaves out too.
    """
    return figures(run).get("free_run") or figures(run).get("before")


def figures(run: Run) -> dict[str, go.Figure]:
    """Every figure that the data of the run allow, by name, in the order of the report.

    Those of series need the records: a run made by ``spiral.discover`` or ``spiral.add``. They are
    computed once for a run.
    """
    from spiral.view.report.html import figures as drawn

    return {shown.name: shown.figure for shown in drawn(saved_form(run), run_curves(run))}


@lru_cache(maxsize=8)
def _cached_curves(key: _RunKey) -> Curves:
    from spiral.io.compute_curves import gather_curves
    from spiral.io.curves import FINAL, SEED

    run = key.run
    done = [r.comparison for r in run.rounds]
    compared = {SEED: done[0], FINAL: done[-1]} if len(done) > 1 else {FINAL: done[-1]}
    return gather_curves(run.question, compared)


class _RunKey:
    """A run as a key of the cache of curves, compared by identity."""

    def __init__(self, run: Run) -> None:
        self.run = run

    def __hash__(self) -> int:
        return id(self.run)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _RunKey) and other.run is self.run


def run_curves(run: Run) -> Curves | None:
    """The time series that figures need; nothing where the run has no records in memory."""
    return None if run.question is None else _cached_curves(_RunKey(run))


def saved_form(run: Run) -> dict[str, Any]:
    """A run as it would be saved, as plain data: what the report is drawn from."""
    from spiral.io.registry import load_registry
    from spiral.io.storage import saved_run_content
    from spiral.io.writing import replace_nonfinite

    asked = require_run(run).question
    data = {} if asked is None else {"records": asked.records, "test": asked.test}
    saved = saved_run_content("discover", run.as_dict(), run.model, {}, data, load_registry(None))
    return replace_nonfinite(saved)


def _finite_result(run: Run) -> Mapping[str, Any]:
    from spiral.io.writing import replace_nonfinite

    return replace_nonfinite(require_run(run).as_dict())
