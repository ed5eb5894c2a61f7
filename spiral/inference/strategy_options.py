"""The options of each strategy: thresholds with their default values and reasons.

Levels and sizes that all strategies share are ``Settings`` (``spiral.inference.problem``). Numbers
that only decide how fast the same answer is found stay with the code that uses them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from spiral.engine.gate import Gate
from spiral.inference.problem import DECISIVE_ODDS
from spiral.types.derivative import Derivative
from spiral.types.errors import ConfigError
from spiral.types.learner import Learner
from spiral.types.library import Library


@dataclass(frozen=True)
class LikelihoodOptions:
    """The thresholds of ``strategy=likelihood``.

    Fields
    ------
    rivals : candidates that are refitted in a round, best score first; each is a fit of its own.
    judged : winners that may be judged in a round, each at its share of the round's level
        (Bonferroni): a first one that is refused makes room for those behind it (decision 131).
    odds : ratio of likelihoods under which two candidates are called alike.
    random_limit : random force, as a share of the machine's own rates, beside which no effect is
        admitted: it follows the record whatever the model says (decision 133). No fit has a larger
        one than 1.
    listed : suggestions that a round tells.
    laws : whether laws with a closed form are tried where no candidate explains what is left
        (decision 158).
    """

    rivals: int = 8
    judged: int = 3
    odds: float = DECISIVE_ODDS
    random_limit: float = 1.0
    listed: int = 5
    laws: bool = True

    def __post_init__(self) -> None:
        """Refuse values out of range."""
        _check_at_least("rivals", self.rivals, 1)
        _check_at_least("judged", self.judged, 1)
        _check_at_least("odds", self.odds, 1.0)
        _check_at_least("random_limit", self.random_limit, 0.0)
        _check_at_least("listed", self.listed, 1)


@dataclass(frozen=True)
class ShootingOptions:
    """The thresholds of ``strategy=shooting``.

    Fields
    ------
    rivals : candidates refitted beside the first; their held-out errors decide between them.
    rival_share : least share of the first one's gain to be a rival: gains are promised by one step
        of the fit, and refits change their order.
    memory_share : share of what is left beyond noise that an effect without memory must explain so
        that effects with states of their own are not tried too.
    tried : suggestions of a diagnosis whose test error is worked out; each is a fit of its own.
    listed : suggestions that a round tells.
    """

    rivals: int = 4
    rival_share: float = 0.5
    memory_share: float = 0.7
    tried: int = 3
    listed: int = 5

    def __post_init__(self) -> None:
        """Refuse values out of range."""
        _check_at_least("rivals", self.rivals, 0)
        _check_share("rival_share", self.rival_share)
        _check_share("memory_share", self.memory_share)
        _check_at_least("tried", self.tried, 1)
        _check_at_least("listed", self.listed, 1)


@dataclass(frozen=True)
class InnovationOptions:
    """The thresholds of ``strategy=innovation``, beside those of its gates.

    Fields
    ------
    gate : tests that candidates pass, in order; ``gate=[a,b]`` and ``gate.NAME.FIELD``.
    train : share of the samples that is regressed; the others validate (as in the paper, 70 %).
    block : samples of the blocks in which the two lie spread over the record, long against the
        memory of whitened innovations.
    listed : suggestions that a round tells.
    """

    gate: tuple[Gate, ...]
    train: float = 0.7
    block: int = 256
    listed: int = 5

    def __post_init__(self) -> None:
        """Refuse values out of range."""
        _check_train_share(self.train)
        _check_at_least("block", self.block, 16)
        _check_at_least("listed", self.listed, 1)


@dataclass(frozen=True)
class PaperOptions:
    """The choices of ``strategy=paper``: its plugins, and how it splits and samples.

    Fields
    ------
    gate : tests that terms pass, in order: guard, Gate 1, refinements, Gate 2 (Algorithm 1);
        ``gate=[a,b]`` and ``gate.NAME.FIELD``.
    derivative : how y' and y'' are estimated; ``derivative=NAME``.
    learner : what learns the residual; ``learner=NAME``.
    library : which terms may be missing; ``library=NAME``.
    train : share of the samples that is fitted; the others validate (the paper's 70 %).
    split : ``blocks`` of samples spread over the record, or its ``tail`` for validation.
    block : samples of such a block, long against the correlation of differentiated noise.
    sampling : where the learned residual is evaluated: a Halton ``box``, the ``trajectory``, or
        ``samples``, which regresses the residual itself and learns nothing.
    points : of the Halton sequence (the paper's 1e5).
    seed : of the learner, the scrambling of the sequence, and resampling.
    listed : suggestions that a round tells.
    """

    gate: tuple[Gate, ...]
    derivative: Derivative
    learner: Learner
    library: Library
    train: float = 0.7
    split: Literal["blocks", "tail"] = "blocks"
    block: int = 256
    sampling: Literal["box", "trajectory", "samples"] = "box"
    points: int = 100_000
    seed: int = 0
    listed: int = 5

    def __post_init__(self) -> None:
        """Refuse values out of range, and gates that need a likelihood."""
        _check_train_share(self.train)
        _check_at_least("block", self.block, 16)
        _check_at_least("points", self.points, 1000)
        _check_at_least("seed", self.seed, 0)
        _check_at_least("listed", self.listed, 1)
        for gate in self.gate:
            if gate.likelihood:
                raise ConfigError(
                    f"gate={gate.plugin_name()} with strategy=paper",
                    "a gate that judges a regression on derivatives",
                    f"strategy=innovation gate=[{gate.plugin_name()}]",
                )


def _check_train_share(share: float) -> None:
    if not 0.1 <= share <= 0.95:
        raise ConfigError(f"strategy.train={share:g}", "a share between 0.1 and 0.95")


def _check_share(name: str, value: float) -> None:
    if not 0 < value <= 1:
        raise ConfigError(f"strategy.{name}={value:g}", "a share above 0, up to 1")


def _check_at_least(name: str, value: float, least: float) -> None:
    if not value >= least:
        raise ConfigError(f"strategy.{name}={value:g}", f"at least {least:g}")
