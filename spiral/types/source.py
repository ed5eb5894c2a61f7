"""Sources: where a record comes from."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from spiral.types.plugin import Plugin
from spiral.types.record import Record
from spiral.types.system import System


class Source(Plugin):
    """Where records come from: a file, a simulation, an instrument.

    One source gives one or several records of one machine. Its fields are the configuration's
    ``record.FIELD`` and ``test.FIELD``.
    """

    kind: ClassVar[str] = "source"

    @abstractmethod
    def load(self, system: System) -> tuple[Record, ...]:
        """The records, checked against ``system`` and in its units.

        Raises
        ------
        InputError : what is there cannot be used; the message says what to change.
        """

    def as_test(self) -> Source:
        """The source of a test record: this one, for the fields that the test leaves out."""
        return self
