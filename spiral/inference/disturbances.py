"""Sentences on random forces and sensor noise, and on how a record departs from its model."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spiral.types.formatting import capitalised, duration, join_words, number, percent, plus_minus
from spiral.types.label import split_key
from spiral.types.model import Model
from spiral.types.noise import COLOURED, FORCES
from spiral.types.parameter import BETWEEN, HELD, Interpolation
from spiral.types.run import Comparison
from spiral.types.system import has_coordinates

_STATES = {"observed": "the measured states", "hidden": "the hidden states"}
_OPEN = 1 / 3  # of a value, from which its standard error leaves it open
_SENSITIVE = 0.3  # free-run error by uncertainty alone from which the sentence is given


def random_shares(comparison: Comparison, *kinds: str) -> dict[str, float]:
    """Shares of what acts at random, by name, of the given kinds (``force``, ``drift``, ...)."""
    return {k: v for k, v in (comparison.random or {}).items() if k.partition(".")[0] in kinds}


def random_forces(comparison: Comparison) -> dict[str, float]:
    """Forces that act at random beside the model, by name, as shares of the machine's own."""
    return random_shares(comparison, *FORCES)


def coloured_noise(comparison: Comparison) -> dict[str, float]:
    """Noise of sensors that is not white, by name, as shares of what these show."""
    return random_shares(comparison, *COLOURED)


def what_acts(model: Model) -> str:
    """What changes the states of a machine: a force, or a flow where it has no coordinates."""
    return "force" if has_coordinates(model.system) else "flow"


def random_sentence(comparison: Comparison) -> str:
    """What acts at random beside white noise of the sensors; empty where nothing does."""
    said, acting = [], what_acts(comparison.model)
    for name, share in (comparison.random or {}).items():
        kind, _, where = name.partition(".")
        time = comparison.random_times.get(name)
        lasting = _spectrum_clause(kind, time)
        if kind in FORCES:
            said.append(
                f"a random {acting} acts on {_STATES.get(where, where.removesuffix('_rate'))}: "
                f"{percent(share)} of the machine's own {acting}s{lasting}"
            )
        elif kind == "drift":
            said.append(f"sensor {where} drifts by {percent(share)} of its motion over the record")
        elif kind == "vibration" and time:
            hertz = number(1 / (2 * np.pi * time), 3)
            said.append(f"sensor {where} rings at {hertz} Hz: {percent(share)} of its motion")
        else:
            said.append(
                f"the noise of sensor {where} is not white: {percent(share)} of its motion{lasting}"
            )
    if random_forces(comparison) and np.isfinite(comparison.disturbed):
        much = comparison.disturbed >= 1.0
        share = "all" if much else percent(comparison.disturbed)
        said.append(f"random {acting}s move a free run by {share} of the motion")
    if comparison.drifting > comparison.noise_floor:
        said.append("a free run errs by what a sensor drifts, also that of a right model")
    text = "; ".join(said)
    return capitalised(text) + "." if text else ""


def _spectrum_clause(kind: str, time: float | None) -> str:
    """How what acts at random is spread over frequency, as the end of a sentence."""
    if time is None:
        return ", white" if kind in FORCES else ""
    if kind == "swell":
        return f", around {number(1 / (2 * np.pi * time), 2)} Hz"
    return f", correlated over {duration(time)}"


def record_sentence(comparison: Comparison) -> str:
    """Invalid readings, inputs between samples, departures from model and noise, in a sentence."""
    said = (
        *comparison.spoilt,
        *input_sentences(comparison.between),
        *comparison.departures,
        *_sensitivity_sentences(comparison),
        *_bound_sentences(comparison.model),
    )
    text = "; ".join(said)
    return capitalised(text) + "." if text else ""


def input_sentences(between: Mapping[str, Interpolation]) -> tuple[str, ...]:
    """A sentence for each interpolation that was estimated, with the inputs that run so."""
    said = []
    for way in dict.fromkeys(between.values()):
        names = [name for name, own in between.items() if own == way]
        several = len(names) > 1
        said.append(
            f"with this model {join_words(names)} between {'their' if several else 'its'} samples "
            f"{'are' if several else 'is'} most likely {BETWEEN[way]} "
            f"(record.hold={way} declares it{_like_a_delay(way)})"
        )
    return tuple(said)


def _like_a_delay(way: Interpolation) -> str:
    """What an input that is held looks like: it acts half a sample late on average."""
    late = HELD.get(way)
    if late is None:
        return ""
    samples = f"{late + 0.5:g} samples" if late else "half a sample"
    return f"; {samples} of lag or delay looks the same"


def _bound_sentences(model: Model) -> tuple[str, ...]:
    """A sentence for every parameter of the system itself that a fit has moved to a bound."""
    table, said = model.estimates().get("system", {}), []
    for key, parameter in model.pairs:
        owner, name = split_key(key)
        if owner != "system" or key not in model.active or name not in table:
            continue
        value = table[name].estimate
        at = [b for b in (parameter.lower, parameter.upper) if b is not None]
        for bound in (b for b in at if np.isclose(value, b, rtol=1e-6, atol=0.0)):
            beyond = "with the other sign" if bound == 0 else "beyond it"
            said.append(
                f"the value of {name} lies at its bound of {number(bound)}: with this model the "
                f"record asks for a value {beyond}"
            )
    return tuple(said)


def _sensitivity_sentences(comparison: Comparison) -> tuple[str, ...]:
    """A sentence where uncertain initial states and values dominate a free run, as in chaos.

    None for a free run that follows its record all the same.
    """
    lost = comparison.test_error > 3 * comparison.noise_floor
    if not (
        lost
        and comparison.uncertain > max(_SENSITIVE, comparison.disturbed, 3 * comparison.noise_floor)
    ):
        return ()
    made = percent(comparison.uncertain)
    if told := _open_values(comparison.model):
        return (f"this record leaves {join_words(told)} open, by which a free run may err by "
                f"{made}: fix what is known, or record a motion that tells them",)  # fmt: skip
    return (f"the uncertainty of initial state and parameters alone makes a free-run error of "
            f"{made}: no model predicts such a motion for so long",)  # fmt: skip


def _open_values(model: Model) -> list[str]:
    """Fitted values with their errors, where these are more than a third of them."""
    return [
        f"{name} ({plus_minus(one.estimate, one.se)})"
        for owner in model.estimates().values()
        for name, one in owner.items()
        if one.se is not None and one.se > _OPEN * abs(one.estimate)
    ]
