"""What a person sees of reconstructed states."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from spiral.types.formatting import number, percent, plus_minus, probability
from spiral.view.terminal.parts import (
    Screen,
    command,
    heading,
    next_steps,
    parameter_table,
    ruled,
    warn_unconverged,
)

if TYPE_CHECKING:
    from spiral.inference.reconstruction.estimate import Estimation, Reconstructed
    from spiral.io.request import Outcome

VERBS = ("estimate",)


def show(verb: str, outcome: Outcome) -> None:
    """Print an outcome on standard output."""
    console = Screen(highlight=False)
    found: Estimation = outcome.parts["estimation"]
    for part in found.parts:
        record = part.record
        length = record.samples * record.dt
        console.print(Text(f"{record.name}: {record.samples} samples, {length:.4g} s", "dim"))
    fitted = outcome.parts["calibration"]
    if fitted is not None:
        heading(console, f"Model, fitted on stretches of {fitted.horizon} samples")
        console.print(parameter_table(fitted.model))
        if fitted.untold:
            console.print(Text(f"not told by these records: {', '.join(fitted.untold)}", "yellow"))
    heading(console, f"States by {found.observer}, after the first second")
    console.print(_states(found))
    for line in _tracked(found):
        console.print(Text(line))
    for line in _doubts(found):
        console.print(Text(line))
    for part in found.parts:
        _trust(console, part, len(found.parts) > 1)
    seen = found.observability
    ratio = seen.singular_values[0] / max(seen.singular_values[-1], 1e-300)
    console.print(
        f"observability rank {seen.rank} of {len(seen.singular_values)}, singular values over "
        f"{ratio:.1e}, weakest {seen.weakest}"
    )
    for written in outcome.parts["written"]:
        console.print(Text(f"written: {written.file}, {written.rows} rows"), soft_wrap=True)
    warn_unconverged(console, outcome)
    request = outcome.parts["request"]
    next_steps(
        console,
        (command("estimate", request, ["observer=rts"]), "each sample judged by the whole record"),
        (f"{command('estimate', request)} --out states.csv", "states with their bands as a table"),
    )


def _states(found: Estimation):
    known = any(s.relative is not None for s in found.states.values())
    columns = ["state", "error", "static", "correlation", "in 95 %", "1 sigma"]
    shown = columns if known else ["state", "1 sigma"]
    table = ruled(*shown, "unit", right=shown[1:])
    for name, score in found.states.items():
        cells = {
            "state": name,
            "error": percent(score.relative),
            "static": percent(found.baseline.get(name)),
            "correlation": number(score.correlation, 6),
            "in 95 %": percent(score.coverage_95),
            "1 sigma": number(score.deviation, 3),
        }
        table.add_row(*(cells[c] for c in shown), score.unit)
    return table


def _tracked(found: Estimation) -> list[str]:
    """Parameters followed beside the states, with the value they ended with."""
    first, lines = found.parts[0], []
    at = max(first.found.done - 1, 0)
    for name in first.found.names[len(first.task.states) :]:
        mean, deviation = (float(v[at]) for v in first.found.state(name))
        lines.append(f"{name} {plus_minus(mean, deviation)} {first.unit(name)} at the end")
    return lines


def _doubts(found: Estimation) -> list[str]:
    """Uncertain parameters, before the first record and after; those of a fit are in its table."""
    prior = found.parts[0].task.prior
    if prior is None or prior.told:
        return []
    return [
        f"{name} {plus_minus(d['estimate'], d['se'])} {d['unit']}, doubt before {d['before']:.3g}"
        for name, d in found.parts[0].doubts.items()
    ]


def _trust(console: Console, part: Reconstructed, named: bool) -> None:
    """Innovations in words: prediction, NIS and its bands, whiteness."""
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
    levels = ", ".join(f"{k} {v:.2g}" for k, v in part.found.levels.items())
    if levels:
        console.print(f"process noise, share of the rates: {levels}")
