"""A missing force that has memory: where it acts, how large it is, of which kind, its loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from spiral.types.formatting import number, percent
from spiral.types.record import Array
from spiral.types.run import Round

Kind = Literal["yields", "relaxes", "either"]
_KINDS = {
    "yields": "It depends on the path, not the speed: hysteresis, or friction that starts elastic.",
    "relaxes": "It lags the motion and decays with time: a relaxing spring or damper.",
    "either": "Whether it depends on the path alone, or relaxes with time, is not clear.",
}


@dataclass(frozen=True)
class Loop:
    """The missing force over the position along one axis, through the largest motion in time."""

    axis: str
    position: Array
    force: Array


@dataclass(frozen=True)
class Memory:
    """A missing force that depends on the past of the motion, not on its present state alone.

    Parameters
    ----------
    port : where it acts best. kind : ``yields`` (whatever the speed), ``relaxes``, or ``either``.
    size : rms of what no function of the present position and velocity explains, in ``unit``.
    share : of the mean square of all that is missing beside a spring and a damper.
    p_value : on the blocks that select; ``log_ratio`` of likelihoods on those that judge.
    stand_ins : effects without memory that the model holds, and that give way to it.
    loops : one for each axis of the port; positions in ``position_unit``.
    """

    port: str
    kind: Kind
    size: float
    share: float
    unit: str
    position_unit: str
    p_value: float
    log_ratio: float
    loops: tuple[Loop, ...]
    stand_ins: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """In words."""
        return (
            f"What is missing has memory: at {self.port} {number(self.size, 2)} {self.unit} (rms) "
            f"depend on the history of the motion, {percent(min(self.share, 1.0))} of the "
            f"missing force's mean square. {_KINDS[self.kind]}"
        )

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it."""
        loops = [
            {"axis": x.axis, "position": x.position.tolist(), "force": x.force.tolist()}
            for x in self.loops
        ]
        return {**vars(self), "sentence": self.sentence, "loops": loops}


def memory_sentence(rounds: Sequence[Round]) -> str:
    """The memory of what is left after a study, in words; empty where none was seen."""
    return rounds[-1].details.get("memory", {}).get("sentence", "")


def memory_stand_ins(rounds: Sequence[Round]) -> tuple[str, ...]:
    """Effects admitted in a study that may only stand in for the memory of what is left."""
    return tuple(rounds[-1].details.get("memory", {}).get("stand_ins", ()))
