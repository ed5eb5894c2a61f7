"""Libraries: which terms may be missing from the observable equations of motion.

A term is one column of a regression: the force of an effect for one of its amplitudes set to one.
Every equation takes part in it, so a term whose physics acts on both axes has one coefficient.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from spiral.types.effect import Effect, ForceEffect
from spiral.types.errors import ConfigError, PluginError
from spiral.types.plugin import Plugin
from spiral.types.system import System


@dataclass(frozen=True)
class Term:
    """One candidate.

    Parameters
    ----------
    effect : whose force it is; bare where it has no physical name.
    key : the full name of its amplitude, ``gyroscopic.coefficient``.
    category : the paper's category (table CandidateLibrary).
    mechanism : its physical origin, in words; what an admitted term is annotated with.
    predicted : the coefficient that a full system's projection gives it, in the system's units.
    """

    effect: Effect
    key: str
    category: str
    mechanism: str
    predicted: float | None = None


class Library(Plugin):
    """A set of terms, structured by physical mechanism rather than by degree.

    Its fields are the configuration's ``library.FIELD``. Callers use ``terms_of``, which checks
    every term's dimensions; a plugin need not.
    """

    kind: ClassVar[str] = "library"
    closure: ClassVar[bool] = False
    """Whether the learned residual itself is a last candidate (the paper's residual closure)."""

    @abstractmethod
    def terms(self, system: System) -> tuple[Term, ...]:
        """All terms that this library has for a system, those of its seed included."""


def terms_of(library: Library, system: System) -> tuple[Term, ...]:
    """The library's terms, each dimensionally admissible.

    A term is admissible where its force, evaluated with units, is that of the port (an
    acceleration where the system is per unit mass). A coefficient may carry a unit, but it must
    be that of a declared parameter of an effect: the paper's own table (W x, x^2, ...) fails the
    stricter reading in which a term alone has the unit of the equation.

    Raises
    ------
    PluginError : a term whose units do not fit, or whose key is no amplitude of its effect.
    ConfigError : no term for this system.
    """
    from spiral.types.units import check_units

    terms = library.terms(system)
    if not terms:
        raise ConfigError(
            f"library {library.plugin_name()!r} for system {system.plugin_name()!r}",
            "a library with terms for it",
            "library=paper",
        )
    for effect in {t.effect.label: t.effect for t in terms}.values():
        if not isinstance(effect, ForceEffect):
            raise PluginError(f"term of {effect.label!r}", "the force of an effect")
        check_units(system, effect)
    for term in terms:
        own = [k for k, p in term.effect.keys(system.place(term.effect)) if _is_amplitude(p)]
        if term.key not in own:
            raise PluginError(f"term {term.key!r}", f"an amplitude of its effect: {', '.join(own)}")
    return terms


def _is_amplitude(parameter) -> bool:
    return parameter.role == "amplitude"
