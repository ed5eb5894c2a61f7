"""Where a test record begins that goes on from a fitted one: from all that was read before it.

A slow hidden state (a store of hours beside a record of minutes) is told by the readings of hours,
and by no settling part. A filter runs over the fitted record and the first sample behind it,

    x ~ N(m, S),    m and S its filtered mean and covariance there,

and the readings of the settling part are weighed with that by the smoother.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spiral.engine.filter.extended import filter_record
from spiral.engine.filter.setup import choose_levels, smoothed_states, with_level
from spiral.engine.filter.setup import prepare_filter as filter_prepared
from spiral.engine.filter.task import FilterInput, with_start_spread
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.horizons import filter_task
from spiral.inference.likelihood.fitting import force_levels
from spiral.types.model import Model
from spiral.types.record import Array, Record

_AT_ONCE = 1e-3  # of a sample, by which a record that goes on from another may begin beside it


def continued_start(
    fitted: Assembly, state: FitState, model: Model, head: Record, task: FilterInput
) -> Array | None:
    """(n,) the first state of a test record, by what was read before; nothing where none was.

    ``head`` is its settling part, ``task`` the filter's input for that.
    """
    before = _record_before(fitted, head)
    if before is None or state.noise is None:
        return None
    levels, n = force_levels(state.noise), len(task.states)
    joined = fitted.study.series[before].record.followed_by(head.part(0, 1, head.name))
    whole = filter_task(fitted, model, state.values[before], joined, task.series.substeps, task)
    if state.starts is not None:
        whole = replace(whole, start=state.starts[before])
    own, settings = filter_prepared(whole, ())
    run = filter_record(own, with_level(own, settings, choose_levels(own, settings, levels)))
    mean, variances = run.means[-1, :n], run.variances[-1, :n]
    if run.done < joined.samples or not np.isfinite([*mean, *variances]).all():
        return None
    begun = with_start_spread(replace(task, start=mean), np.sqrt(np.maximum(variances, 0.0)))
    return smoothed_states(begun, levels, ())[0, :n]


def _record_before(fitted: Assembly, head: Record) -> int | None:
    """The fitted record that ends a sample before this one begins, of the same file."""
    for place, series in enumerate(fitted.study.series):
        record = series.record
        apart = head.time[0] - record.time[-1] - record.dt
        if head.name.startswith(record.name) and abs(apart) <= _AT_ONCE * record.dt:
            return place
    return None
