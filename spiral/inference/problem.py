"""The input of a study: a model, records to fit, test records, candidates, settings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from spiral.types.effect import Effect, StateFlow
from spiral.types.invalid import invalid_words
from spiral.types.model import Model
from spiral.types.parameter import Interpolation
from spiral.types.placement import at_fitting_places
from spiral.types.plugin import Plugin
from spiral.types.record import Record
from spiral.types.run import Suggestion

DECISIVE_ODDS = 100.0
"""Ratio of likelihoods from which one model is told from another: what Jeffreys calls decisive.

Source: H. Jeffreys, Theory of Probability, appendix B.
"""

Progress = Callable[[str], None]
"""Called with a message that says what is being done."""


class ScoreMessage(str):
    """A message of progress that carries all candidates as scored, before any is refitted.

    ``suggestions`` and their order are preliminary: refits change what each explains.
    """

    suggestions: tuple[Suggestion, ...]

    def __new__(cls, words: str, suggestions: Sequence[Suggestion]) -> ScoreMessage:
        """The message in words, with its suggestions, the best first."""
        message = super().__new__(cls, words)
        message.suggestions = tuple(suggestions)
        return message


def silent(message: str) -> None:
    """A progress function that drops its message."""


@dataclass(frozen=True)
class Settings:
    """Levels and sizes of the statistics; plain numbers with the field's usual values.

    Fields
    ------
    level : family-wise error of a whole study, spent over its rounds.
    smallest : smallest change of the predicted response that counts, in noise standard deviations.
    smallest_share : smallest change of the predicted response that counts where the model's error
        is within the noise already, in deviations of a reading.
    max_rounds : rounds after which the loop stops.
    seconds : time from which the search ends with what is known by then; 0 for no limit. The fit of
        the seed is not interrupted.
    alias_level : significance at which two candidates' prediction errors are told apart.
    whiteness_level : significance at which residuals are called coloured.
    lags : lags of the Ljung-Box statistic.
    share : smallest contribution of a term that a test is planned for, of the acceleration's rms.
    miss : probability of missing such a term.
    chi2_limit : chi2 per degree of freedom, and its inverse, beyond which the noise does not
        explain what a model leaves: evidence relies on a noise model that is right within this.
    random_limit : share of the machine's own rates up to which a force that acts at random is an
        answer; beyond it the model lacks something.
    noise_limit : share of a channel's deviation up to which coloured noise of its sensor is an
        answer; beyond it the noise stands in for the machine.
    least_t : |estimate| over standard error under which an effect is not called missing.
    learned : whether ``discover`` admits a learned curve where no candidate explains what is left.
    phase_knot : seconds between knots of the smooth phase correction that a fitted record gets
        where its phase is integrated from a measured speed; 0 switches it off.
    """

    level: float = 0.01
    smallest: float = 0.1
    smallest_share: float = 0.005
    max_rounds: int = 8
    seconds: float = 0.0
    alias_level: float = 0.01
    whiteness_level: float = 0.001
    lags: int = 40
    chi2_limit: float = 2.0
    random_limit: float = 0.2
    noise_limit: float = 0.5
    least_t: float = 3.0
    share: float = 0.1
    miss: float = 0.05
    phase_knot: float = 1.0
    learned: bool = False


@dataclass(frozen=True)
class Problem:
    """The input of one study.

    ``records`` are fitted; ``test`` is seen neither by fit nor by selection, its first ``settle``
    seconds only fix its own nuisances; ``candidates`` are the effects that may be missing.
    ``dictionary`` are learned effects, ``varying`` the forms in which the model's own parameters
    may follow what moves (``changes`` at their places), tried where no candidate explains what is
    left.
    ``strategy`` is the plugin of that kind which supplies the evidence
    (``spiral.inference.rounds.strategy_for``); steps that need none leave it out.
    ``scaled`` are shapes that nobody gave a value.
    """

    model: Model
    records: tuple[Record, ...]
    test: tuple[Record, ...]
    settle: float | None = None
    candidates: tuple[Effect, ...] = ()
    settings: Settings = field(default_factory=Settings)
    dictionary: tuple[Effect, ...] = ()
    varying: tuple[Effect, ...] = ()
    strategy: Plugin | None = None
    scaled: tuple[str, ...] = ()

    def with_growth(self, growth: Mapping[str, tuple[float, float, float]]) -> Problem:
        """The same with noise that grows with its reading (``Record.growth``)."""
        records, test = (
            tuple(replace(r, growth=growth) for r in some) for some in (self.records, self.test)
        )
        return replace(self, records=records, test=test)

    def changes(self) -> tuple[Effect, ...]:
        """Changes of each parameter with each variable that it may follow."""
        return at_fitting_places(self.model.system, self.varying)

    def candidates_beside(self, effect: Effect) -> tuple[Effect, ...]:
        """The candidates at an effect's place, and flows into the same states from anywhere.

        A loss that follows a temperature and one that follows its distance from the room's differ
        little where the room's hardly changes.
        """
        system, at = self.model.system, self.model.system.place(effect)

        def is_beside(other: Effect) -> bool:
            place = system.place(other)
            flows = isinstance(effect, StateFlow) and isinstance(other, StateFlow)
            return place.name == at.name or (flows and place.axes == at.axes)

        return tuple(e for e in self.candidates if is_beside(e))

    def spoilt_sentences(self) -> tuple[str, ...]:
        """Doubts of the records, and what readings are no measurement, in words, once each.

        Those of the test records are named as such.
        """
        doubts: dict[str, str] = {}
        for record in (*self.records, *self.test):
            doubts = {**record.doubts, **doubts}
        fitted = invalid_words([(r.spoilt, r.samples) for r in self.records])
        tested = invalid_words([(r.spoilt, r.samples) for r in self.test])
        return (*doubts.values(), *fitted, *(f"in the test record, {words}" for words in tested))

    def running(self, ways: Mapping[str, Interpolation]) -> Problem:
        """The same with these interpolations of inputs (``Record.running``)."""
        if not ways:
            return self
        records, test = (tuple(r.running(ways) for r in x) for x in (self.records, self.test))
        return replace(self, records=records, test=test)
