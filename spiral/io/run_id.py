"""Names of saved runs, studies and sweeps: their order is the order in which they were begun."""

from __future__ import annotations

import re
import secrets
from collections.abc import Iterable
from contextlib import suppress
from datetime import UTC, datetime, timedelta

_STAMP = re.compile(r"\d{8}-\d{6}-\d{3}")
_FORM = "%Y%m%d-%H%M%S-%f"


def new_run_id(now: datetime | None = None, others: Iterable[str] = ()) -> str:
    """A time and a few random characters: ``20250131-142501-0363fa9c2bb``.

    It sorts behind all ``others``, which lie in the same folder: where the clock was set back, the
    time is that of the last of them, and a millisecond.
    """
    stamp = _stamp(now or datetime.now(UTC))
    last = max((match[0] for name in others if (match := _STAMP.match(name))), default="")
    if stamp <= last:
        with suppress(ValueError, OverflowError):  # no time at all, or the last there is
            stamp = _stamp(datetime.strptime(last, _FORM) + timedelta(milliseconds=1))
    return stamp + secrets.token_hex(4)


def _stamp(moment: datetime) -> str:
    return moment.strftime(_FORM)[:-3]
