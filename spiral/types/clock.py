"""Whether time is a clock that a record can have: forward, in even steps, and what to do if not."""

from __future__ import annotations

import numpy as np

from spiral.types.errors import InputError

Array = np.ndarray

MINIMUM_SAMPLES = 64
JITTER = 0.02  # largest deviation of a time step from the mean one, as a share of it
_OFF, _FEW = 0.25, 0.05  # shares: of a step that a clock with lost rows is off by, and how often
_COARSE = 0.02  # share of steps of zero from which a clock is coarser than the rows
_SCATTERED = -0.25  # correlation of a time step and the next: half that of stamps that scatter


def check_increasing(name: str, time: Array) -> None:
    """Refuse too few samples, and time that is not a number or does not increase."""
    if len(time) < MINIMUM_SAMPLES:
        raise InputError(
            f"{name}: {len(time)} samples", f"at least {MINIMUM_SAMPLES}", "use a longer record"
        )
    if not np.all(np.isfinite(time)):
        row = int(np.flatnonzero(~np.isfinite(time))[0])
        raise InputError(f"{name}: time at row {row} is not a number", "numbers in every row")
    check_forward(name, time)


def check_forward(name: str, time: Array) -> None:
    """Refuse time that stands or runs backwards."""
    steps = np.diff(time)
    back = np.flatnonzero(steps <= 0)
    if not len(back):
        return
    row = int(back[0]) + 1
    raise InputError(
        f"{name}: time runs from {time[row - 1]:.9g} s to {time[row]:.9g} s at row {row}",
        "time that increases in every row",
        suggest_forward_steps(steps),
    )


def suggest_forward_steps(steps: Array) -> str:
    """Advice where time stands or runs backwards: a coarse clock, a wrong order, rows twice."""
    if np.all(steps == 0):
        return "record.rate=HZ in place of the column of time, where the rows are evenly spaced"
    if np.mean(steps == 0) > _COARSE and np.all(steps >= 0):
        return (
            f"the clock is coarser than the rows: record.rate={1 / float(np.mean(steps)):.6g} in "
            "place of the column of time, where they are evenly spaced"
        )
    return "sort the rows by time, and drop those that stand there twice"


def check_time(name: str, time: Array) -> None:
    """Refuse too few samples, and time that does not run forward in even steps."""
    check_increasing(name, time)
    check_uniform(name, time)


def check_uniform(name: str, time: Array) -> None:
    """Refuse time whose steps differ."""
    steps = np.diff(time)
    mean = (time[-1] - time[0]) / (len(time) - 1)
    worst = int(np.argmax(np.abs(steps - mean)))
    if abs(steps[worst] - mean) > JITTER * mean:
        raise InputError(
            f"{name}: steps of time differ ({steps.min():.6g} to {steps.max():.6g} s, "
            f"worst after row {worst})",
            f"a uniform step (here {mean:.6g} s within {JITTER:.0%})",
            suggest_even_steps(steps, mean),
        )


def suggest_even_steps(steps: Array, mean: float) -> str:
    """Advice where time steps differ: bridge gaps, resample uneven steps, count rows.

    Steps between stamps that scatter about an even clock are followed by opposite ones (their
    correlation is -1/2); those of readings that were taken unevenly are not.
    """
    longest, apart = float(steps.max() / np.median(steps)), steps - mean
    following = float(apart[1:] @ apart[:-1]) / float(apart @ apart)
    if following < _SCATTERED:
        rate = _shortest_rate(steps, mean)
        return (
            f"the stamps scatter about an even clock: record.rate={rate} in place of the "
            f"column of time; record.resample={rate} where the readings were taken so"
        )
    if longest > 1.5:
        usual = float(np.median(steps))
        off = np.abs(steps / usual - np.maximum(np.rint(steps / usual), 1.0))
        gaps = f"record.fill_gaps={round(longest) - 1}"
        if np.mean(off > _OFF) > _FEW:
            return (
                f"record.resample={1 / mean:.4g} makes uneven steps even; where samples are "
                f"missing, {gaps} bridges so many, record.rows cuts there"
            )
        both = "" if np.all(off <= JITTER) else f" together with record.resample={1 / usual:.6g}"
        return f"samples are missing: {gaps}{both} bridges so many, record.rows cuts there"
    return (
        f"record.resample={1 / mean:.4g} makes the steps even, record.rate={1 / mean:.4g} says so"
    )


def _shortest_rate(steps: Array, mean: float) -> str:
    """The rate in Hz with the fewest digits that the scatter of the stamps allows."""
    late = np.cumsum(steps - mean)
    texts = [f"{float(f'{1 / mean:.{digits}g}'):.10g}" for digits in range(2, 7)]
    run = len(steps) * mean
    near = [text for text in texts if abs(float(text) * mean - 1) * run <= np.ptp(late)]
    return near[0] if near else texts[-1]
