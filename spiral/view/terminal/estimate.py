"""Terminal output of ``spiral estimate``: reconstructed states and checks of the filter."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from spiral.types.formatting import number, percent, plus_minus, probability
from spiral.view.terminal.parts import (
    Screen,
    parameter_table,
    print_heading,
    print_next_steps,
    print_outcome_error,
    request_command,
    ruled_table,
)

if TYPE_CHECKING:
    from spiral.inference.reconstruction.estimate import Estimation, RecordReconstruction
    from spiral.io.request import Outcome

VERBS = ("estimate",)


def show(verb: str, outcome: Outcome) -> None:
    """Print an outcome on standard output."""
    console = Screen(highlight=False)
    estimation: Estimation = outcome.parts["estimation"]
    for part in estimation.parts:
        record = part.record
        length = record.samples * record.dt
        console.print(Text(f"{record.name}: {record.samples} samples, {length:.4g} s", "dim"))
    fitted = outcome.parts["calibration"]
    if fitted is not None:
        print_heading(console, f"Model, fitted on stretches of {fitted.horizon} samples")
        console.print(parameter_table(fitted.model))
        if fitted.untold:
            names = ", ".join(fitted.untold)
            console.print(Text(f"not determined by these records: {names}", "yellow"))
    print_heading(console, f"States by {estimation.observer}, after the first second")
    console.print(_state_table(estimation))
    for line in (*_tracked_parameters(estimation), *_uncertain_parameters(estimation)):
        console.print(Text(line))
    console.print(Text(estimation.band_sentence, "dim"))
    for part in estimation.parts:
        _print_innovation_checks(console, part, len(estimation.parts) > 1)
    seen = estimation.observability
    ratio = seen.singular_values[0] / max(seen.singular_values[-1], 1e-300)
    console.print(
        f"observability rank {seen.rank} of {len(seen.singular_values)}, singular values over "
        f"{ratio:.1e}, weakest {seen.weakest}"
    )
    for written in outcome.parts["written"]:
        console.print(Text(f"written: {written.file}, {written.rows} rows"), soft_wrap=True)
    print_outcome_error(console, outcome)
    request = outcome.parts["request"]
    smoothed = request_command("estimate", request, ["observer=rts"])
    table = f"{request_command('estimate', request)} --out states.csv"
    print_next_steps(
        console,
        (smoothed, "every state estimated from the whole record"),
        (table, "states with their bands as a table"),
    )


def _state_table(estimation: Estimation):
    known = any(s.relative is not None for s in estimation.states.values())
    columns = ["state", "error", "static", "correlation", "in 95 %", "1 sigma"]
    shown = columns if known else ["state", "1 sigma"]
    table = ruled_table(*shown, "unit", right=shown[1:])
    for name, score in estimation.states.items():
        cells = {
            "state": name,
            "error": percent(score.relative),
            "static": percent(estimation.baseline.get(name)),
            "correlation": number(score.correlation, 6),
            "in 95 %": percent(score.coverage_95),
            "1 sigma": number(score.deviation, 3),
        }
        table.add_row(*(cells[c] for c in shown), score.unit)
    return table


def _tracked_parameters(estimation: Estimation) -> list[str]:
    """Parameters that the filter tracks as states, with their values at the end."""
    first, lines = estimation.parts[0], []
    at = max(first.reconstruction.done - 1, 0)
    for name in first.reconstruction.names[len(first.task.states) :]:
        mean, deviation = (float(v[at]) for v in first.reconstruction.state(name))
        lines.append(f"{name} {plus_minus(mean, deviation)} {first.unit(name)} at the end")
    return lines


def _uncertain_parameters(estimation: Estimation) -> list[str]:
    """Uncertain parameters before and after the first record; none where a fit gave them."""
    prior = estimation.parts[0].task.prior
    if prior is None or prior.settled:
        return []
    return [
        f"{name} {plus_minus(d['estimate'], d['se'])} {d['unit']}, standard deviation before "
        f"{d['before']:.3g}"
        for name, d in estimation.parts[0].doubts.items()
    ]


def _print_innovation_checks(console: Console, part: RecordReconstruction, named: bool) -> None:
    """Print checks of the innovations: prediction error, NIS and its bands, whiteness."""
    seen = part.consistency
    console.print()
    if named:
        console.print(Text(part.record.name, "dim"))
    if seen is None:
        console.print("no innovations: nothing is predicted, so nothing can be checked")
        return
    errors = ", ".join(f"{k} {v:.3g}" for k, v in seen.prediction.items())
    console.print(f"one-step prediction error over the noise: {errors} (1: perfect)")
    inside = "inside" if seen.nis.inside else "outside"
    console.print(
        f"NIS {seen.nis.mean:.3f}, {inside} its 95 % bounds {seen.nis.low:.3f} to "
        f"{seen.nis.high:.3f}; by {seen.bands[0].of}: "
        + " ".join(f"{b.nis.mean:.2f}{'' if b.nis.inside else '*'}" for b in seen.bands)
        + (" (* outside)" if any(not b.nis.inside for b in seen.bands) else "")
    )
    console.print(
        f"innovations white: p = {probability(seen.whiteness_p)}, Q/N {seen.whiteness_effect:.2g}"
    )
    levels = ", ".join(f"{k} {v:.2g}" for k, v in part.reconstruction.levels.items())
    if levels:
        console.print(f"process noise, share of the rates: {levels}")
