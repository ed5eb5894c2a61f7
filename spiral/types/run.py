"""Results of the steps (compare, diagnose, discover) as immutable values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from spiral.types.display import Readable, Summary
from spiral.types.errors import ConfigError
from spiral.types.formatting import number, percent, probability, sentences
from spiral.types.horizon import Change, Horizon
from spiral.types.model import Model, estimates_dict
from spiral.types.parameter import Interpolation
from spiral.types.record import Array

Verdict = Literal["effect_missing", "nothing_missing", "not_identifiable", "unknown_structure"]
"""What a study says of its seed: an effect is missing and named; nothing is missing; the record
cannot tell the model's effects apart; something is missing that no candidate explains."""

StopReason = Literal[
    "whiteness", "no_candidate", "not_identifiable", "diverged", "max_rounds", "max_seconds"
]
"""How a study ended: what is left is white; no candidate passed; the record cannot tell; a fit did
not converge; as many rounds as ``settings.max_rounds`` were made; ``settings.seconds``
were over."""

UNTOLD = "This record does not tell whether more is missing than what acts at random"
"""How a verdict begins where random forces make more of a free run than half of all motion."""

RANDOM_OR_MISSING = (
    "Either much acts at random, or something is missing that no known effect explains"
)
"""How a verdict begins where nothing but the size of a random force speaks against the model."""


@dataclass(frozen=True)
class ChannelError:
    """Free-run error of one channel: rmse in its unit, and over its standard deviation."""

    rmse: float
    relative: float

    def as_dict(self) -> dict[str, float]:
        """As plain data, as ``--json`` writes it."""
        return {"rmse": self.rmse, "relative": self.relative}


@dataclass(frozen=True, eq=False)
class Traces:
    """Time series behind a comparison: arrays (samples, channels) for each record.

    ``fitted`` and ``test`` are free runs, those over test records scored from sample ``settled``
    on; ``left`` is the residual of the fitted records over its standard deviation.
    """

    fitted: tuple[Array, ...]
    test: tuple[Array, ...]
    settled: int
    left: tuple[Array, ...]


@dataclass(frozen=True, repr=False)
class Comparison(Readable):
    """A fitted model compared with the records of its fit, and with test records.

    Fields
    ------
    model : the model with its fitted values.
    fit_error, test_error : relative free-run errors, mean over channels.
    channels : the test's free-run error by channel.
    noise_floor : the test error that a perfect model would have by the noise fitted beside this
        one; ``floor`` is what a person is told.
    chi2_per_dof, whiteness_p : of the fitted records, at window length ``horizon``.
    whiteness_effect : summed squared autocorrelation of their residual, less that of white noise.
    horizon : length of those windows, samples.
    converged : whether the fit converged.
    notes : what to know of this comparison, in words.
    noise_ratio : noise that the fitted records show without a model (high-order differences) over
        what they declare, rms over channels; nothing where they declare none.
    innovation_chi2 : mean squared whitened innovation, where a filter's likelihood is the evidence:
        process noise then explains what a free run misses.
    unseen : errors on the test records at several horizons (``inference.evidence.horizons``), none
        without a test.
    random : random forces, and sensor noise beyond white noise (``engine.likelihood.noise``), by
        name: of a force its share of the rate that it acts on, of a reading its share of the
        channel's deviation; nothing where no such model was fitted.
    random_times : their correlation times in s, where they have one.
    spoilt : which readings are no measurement, in words.
    departures : what neither the model nor its noise can hold, in words: a parameter that drifts,
        noise that grows with its reading.
    contradictions : values that noise does not account for, in words: a sign that turned and that a
        passive machine does not have, most likely values far from those of the best free run.
    disturbed : error of the test's free run to be expected from random forces.
    disturbed_values : how many independent values these make of it, of which it is the rms.
    uncertain : the same from the uncertainty of parameters and initial state.
    drifting : the same from sensors that drift, or whose noise lasts long.
    driven_unseen : whether what moves the fitted records is in none of their inputs.
    followed : share of the sensors' noise that motion and inputs explain of a coloured residual.
    between : how inputs are interpolated.
    traces : the time series behind it; not saved.
    """

    model: Model
    fit_error: float
    test_error: float
    channels: Mapping[str, ChannelError]
    noise_floor: float
    chi2_per_dof: float
    whiteness_p: float
    whiteness_effect: float
    horizon: int
    converged: bool
    notes: tuple[str, ...] = ()
    noise_ratio: float | None = None
    innovation_chi2: float | None = None
    unseen: tuple[Horizon, ...] = ()
    random: Mapping[str, float] | None = None
    random_times: Mapping[str, float] = field(default_factory=dict)
    spoilt: tuple[str, ...] = ()
    departures: tuple[str, ...] = ()
    contradictions: tuple[str, ...] = ()
    disturbed: float = 0.0
    disturbed_values: float = 1.0
    uncertain: float = 0.0
    drifting: float = 0.0
    driven_unseen: bool = False
    followed: float | None = None
    between: Mapping[str, Interpolation] = field(default_factory=dict)
    traces: Traces | None = field(default=None, compare=False, repr=False)

    @property
    def floor(self) -> float:
        """The noise floor, at most the test error: no wrong model is better than a perfect one.

        Beside a model that lacks something, what is fitted as noise with a colour may be more.
        """
        return min(self.noise_floor, self.test_error)

    def _shown(self) -> Summary:
        errors = (self.fit_error, self.test_error, self.floor)
        return Summary(
            f"Comparison of {self.model.name}",
            ("fit error", "test error", "noise floor", "chi2/dof"),
            ((*map(percent, errors), number(self.chi2_per_dof)),),
            "\n".join((repr(self.model), *self.notes, *self.departures, *self.contradictions)),
        )  # fmt: skip

    def estimates(self) -> Any:
        """The model's parameters as a pandas table: estimate, se, t, unit."""
        return _estimate_table({"model": estimates_dict(self.model)})

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it."""
        return {
            "fit_error": self.fit_error,
            "test_error": self.test_error,
            "noise_floor": self.floor,
            "noise_ratio": self.noise_ratio,
            "innovation_chi2": self.innovation_chi2,
            "random": None if self.random is None else dict(self.random),
            "random_times": dict(self.random_times),
            "spoilt": list(self.spoilt),
            "departures": list(self.departures),
            "contradictions": list(self.contradictions),
            "disturbed": self.disturbed,
            "disturbed_values": self.disturbed_values,
            "uncertain": self.uncertain,
            "drifting": self.drifting,
            "driven_unseen": self.driven_unseen,
            "followed": self.followed,
            "between": dict(self.between),
            "channels": {k: v.as_dict() for k, v in self.channels.items()},
            "chi2_per_dof": self.chi2_per_dof,
            "whiteness_p": self.whiteness_p,
            "whiteness_effect": self.whiteness_effect,
            "horizon": self.horizon,
            "converged": self.converged,
            "model": estimates_dict(self.model),
            "notes": list(self.notes),
            "unseen": [h.as_dict() for h in self.unseen],
        }


@dataclass(frozen=True)
class Suggestion:
    """One candidate with its evidence.

    ``explains`` is the share of the residual that it explains; ``net`` the same less what as many
    free parameters explain of noise, 1 - (1 - explains) N^(q/N) for q parameters and N samples
    (Schwarz's criterion as a share), which orders candidates; none where evidence is of another
    kind.
    """

    effect: str
    meaning: str
    aliases: tuple[str, ...]
    p_value: float
    statistic: float
    wald_p_value: float
    explains: float
    hint: tuple[str, ...] = ()
    test_error_before: float | None = None
    test_error_after: float | None = None
    net: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it."""
        return {
            "effect": self.effect,
            "aliases": list(self.aliases),
            "p_value": self.p_value,
            "statistic": self.statistic,
            "wald_p_value": self.wald_p_value,
            "explains": self.explains,
            "net": self.net,
            "test_error_before": self.test_error_before,
            "test_error_after": self.test_error_after,
            "meaning": self.meaning,
        }


@dataclass(frozen=True)
class Where:
    """Where a model fails: ranges that hold most of the error, and one sentence.

    The missing force follows ``state`` to the ``power`` (an angle: so many times per turn), which
    explains the share ``follows`` of it; no state where none explains enough.
    """

    channel: str | None = None
    sentence: str = ""
    time_s: tuple[float, float] | None = None
    frequency_hz: tuple[float, float] | None = None
    speed_rad_s: tuple[float, float] | None = None
    order: tuple[float, float] | None = None
    amplitude: tuple[float, float] | None = None
    state: str | None = None
    power: int | None = None
    follows: float | None = None
    channels: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it."""
        ranges = ("time_s", "frequency_hz", "speed_rad_s", "order", "amplitude")
        limits = {r: list(v) if (v := getattr(self, r)) else None for r in ranges}
        what = {"state": self.state, "power": self.power, "follows": self.follows}
        said = {"channel": self.channel, "channels": list(self.channels)}
        return {**limits, **what, **said, "sentence": self.sentence}


@dataclass(frozen=True, repr=False)
class Diagnosis(Readable):
    """The result of ``diagnose``: what may be missing, where the model fails, and what to do.

    ``not_separable`` are candidates that effects of the model take over on this record, in part or
    whole: had they been there, they could not have been found. ``unknown`` is the shape of what no
    candidate explains (``spiral.inference.unknown.shape``). ``left_out`` are candidates that these
    records cannot be asked about, and why. ``summary`` is the verdict with its figures; ``memory``
    what is told of a missing force that has any (``spiral.inference.unknown.memory``).
    """

    verdict: Verdict
    comparison: Comparison
    suggestions: tuple[Suggestion, ...]
    where: Where
    advice: str
    horizon: int
    diverged: bool = False
    not_separable: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    unknown: Mapping[str, Any] | None = None
    left_out: Mapping[str, str] = field(default_factory=dict)
    summary: str = ""
    memory: Mapping[str, Any] | None = None

    def _shown(self) -> Summary:
        rows = tuple(
            (s.effect, percent(s.explains), probability(s.p_value), ", ".join(s.aliases), s.meaning)
            for s in self.suggestions[:5]
        )
        return Summary(
            f"{self.verdict}. {self.where.sentence}".strip(),
            ("effect", "explains", "p", "looks like", "meaning"),
            rows,
            self.advice,
        )

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it."""
        return {
            "verdict": self.verdict,
            "summary": self.summary,
            "suggestions": [s.as_dict() for s in self.suggestions],
            "where": self.where.as_dict(),
            "advice": self.advice,
            "horizon": self.horizon,
            "comparison": self.comparison.as_dict(),
            "not_separable": {k: list(v) for k, v in self.not_separable.items()},
            "unknown": self.unknown,
            "memory": self.memory,
            "left_out": dict(self.left_out),
        }


@dataclass(frozen=True)
class Round:
    """One round of the discovery loop; 0 is the seed. ``rejected``: refused candidates -> why.

    ``left_out`` are those of them that the records of the whole study cannot be asked about.
    ``details`` log, as plain data, how the strategy came from this round's model to the next
    proposal; ``changes`` say at each horizon whether the step to this round predicts unseen data
    better than the round before.
    """

    number: int
    admitted: tuple[str, ...]
    aliases: Mapping[str, tuple[str, ...]]
    rejected: Mapping[str, str]
    suggestions: tuple[Suggestion, ...]
    comparison: Comparison
    seconds: float
    second_order: bool = False
    meaning: str = ""
    retired: tuple[str, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)
    changes: tuple[Change, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it."""
        c = self.comparison
        return {
            "round": self.number,
            "admitted": list(self.admitted),
            "aliases": {k: list(v) for k, v in self.aliases.items()},
            "rejected": dict(self.rejected),
            "retired": list(self.retired),
            "fit_error": c.fit_error,
            "test_error": c.test_error,
            "chi2_per_dof": c.chi2_per_dof,
            "horizon": c.horizon,
            "whiteness_p": c.whiteness_p,
            "whiteness_effect": c.whiteness_effect,
            "seconds": self.seconds,
            "second_order": self.second_order,
            "meaning": self.meaning,
            "unseen": [h.as_dict() for h in c.unseen],
            "changes": [h.as_dict() for h in self.changes],
            "model": estimates_dict(c.model),
            "suggestions": [s.as_dict() for s in self.suggestions],
            "details": dict(self.details),
        }


@dataclass(frozen=True, repr=False)
class Run:
    """The result of ``discover``: the rounds of a study with their evidence, and its final model.

    ``missing`` are the effects that the verdict names, ``summary`` says it with its figures.
    ``question`` is the ``Problem`` that it answers, where the run was made in this process.
    """

    verdict: Verdict
    stopped: StopReason
    rounds: tuple[Round, ...]
    model: Model
    advice: str
    alias_groups: tuple[tuple[str, ...], ...] = ()
    run_id: str = ""
    context: Mapping[str, Any] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    summary: str = ""
    question: Any = field(default=None, compare=False)  # the inference.problem.Problem

    def __repr__(self) -> str:
        rows = [
            f"  {n}  {added}: fit {fit}, test {test}, chi2/dof {chi2}"
            for n, added, fit, test, chi2 in self._rows()
        ]
        name = f"Run {self.run_id}".strip()
        return "\n".join(
            [f"{name}: {self.verdict}", *rows, f"{self.summary} {self.advice}".strip()]
        )

    def _repr_markdown_(self) -> str:
        """What a notebook shows: the verdict, and the errors round by round."""
        head = "| round | added | fit error | test error | chi2/dof |"
        lines = [f"| {' | '.join(map(str, row))} |" for row in self._rows()]
        said = [f"**{self.verdict}**"]
        for point, below in sentences(f"{self.summary} {self.advice}"):
            said += [f"- {point}", *(f"    - {clause}" for clause in below)]
        return "\n".join([said[0], "", *said[1:], "", head, "|--:|:--|--:|--:|--:|", *lines])

    def _rows(self) -> list[tuple[int, str, str, str, str]]:
        """Table rows of the rounds: number, effects added, fit and test error, chi2 per dof."""
        rows = []
        for r in self.rounds:
            c = r.comparison
            added = ", ".join(r.admitted) or ("the seed" if r.number == 0 else "nothing")
            added += f" (let go: {', '.join(r.retired)})" if r.retired else ""
            errors = percent(c.fit_error), percent(c.test_error), number(c.chi2_per_dof)
            rows.append((r.number, added, *errors))
        return rows

    def estimates(self) -> Any:
        """The final model's parameters as a pandas table: estimate, se, t, unit."""
        return _estimate_table(self.as_dict())

    def look_alikes(self, label: str) -> tuple[str, ...]:
        """Effects outside the final model that the record cannot tell from one that was added."""
        return untold_effects(self.rounds, label)

    @property
    def final(self) -> Comparison:
        """The comparison of the last round."""
        return self.rounds[-1].comparison

    @property
    def unknown(self) -> Mapping[str, Any] | None:
        """The learned curve of a force that no candidate explains; see ``inference.unknown``."""
        shapes = [r.details["unknown"] for r in self.rounds if "unknown" in r.details]
        return shapes[-1] if shapes else None

    @property
    def memory(self) -> Mapping[str, Any] | None:
        """The description of a missing force with memory, where one is left at the end."""
        return self.rounds[-1].details.get("memory") if self.rounds else None

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it."""
        return {
            "verdict": self.verdict,
            "summary": self.summary,
            "missing": list(self.missing),
            "stopped": self.stopped,
            "rounds": [r.as_dict() for r in self.rounds],
            "model": estimates_dict(self.model),
            "test": {k: v.as_dict() for k, v in self.final.channels.items()} if self.rounds else {},
            "noise_floor": self.final.floor if self.rounds else None,
            "advice": self.advice,
            "alias_groups": [list(g) for g in self.alias_groups],
            "between": dict(self.final.between) if self.rounds else {},
            "run_id": self.run_id,
            "context": dict(self.context),
            "unknown": self.unknown,
            "memory": self.memory,
        }


def admitted_labels(rounds: Sequence[Round]) -> tuple[str, ...]:
    """Effects that were admitted and that the last model still has."""
    held = rounds[-1].comparison.model.labels
    return tuple(dict.fromkeys(x for r in rounds for x in r.admitted if x in held))


def untold_effects(rounds: Sequence[Round], label: str) -> tuple[str, ...]:
    """What the record cannot tell from an admitted effect, effects of the last model apart."""
    alike = dict.fromkeys(a for r in rounds for a in r.aliases.get(label, ()))
    return tuple(a for a in alike if a not in admitted_labels(rounds))


def require_run(given: object) -> Run:
    """The run that was given.

    Raises
    ------
    ConfigError : anything else, a record or a model.
    """
    if not isinstance(given, Run):
        raise ConfigError(
            f"a {type(given).__name__}", "a run, as spiral.discover gives it",
            "run = spiral.discover(record, system)",
        )  # fmt: skip
    return given


def _estimate_table(result: Mapping[str, Any]) -> Any:
    """``estimate_rows`` as a pandas table by effect and parameter."""
    import pandas as pd

    table = pd.DataFrame(estimate_rows(result))
    return table.set_index(["effect", "parameter"]) if len(table) else table


def estimate_rows(result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Table rows, one for each parameter of the final model: estimate, error, t, unit."""
    model = result.get("model") or (result.get("comparison") or {}).get("model") or {}
    owners = {**(model.get("effects") or {}), "system": model.get("system") or {}}
    return [
        {"effect": owner, "parameter": name, **values}
        for owner, table in owners.items()
        for name, values in table.items()
    ]
