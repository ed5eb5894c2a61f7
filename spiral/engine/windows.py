"""Cuts a record into windows, and into blocks for selection and for judgement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spiral.types.record import Array

_FAIR = 0.05  # how far either half's share of a quarter of the motion may be from one half
_SHORTEST = 8  # samples in a block: noise correlated over a few samples still averages out


@dataclass(frozen=True)
class WindowLayout:
    """Windows of one record: ``starts`` and ``lengths`` in samples, and the samples that count."""

    starts: Array
    lengths: Array
    mask: Array | None


def cut_windows(samples: int, length: int, mask: Array | None = None) -> WindowLayout:
    """Windows of ``length`` samples that begin where the mask holds.

    Windows without a sample that counts are left out; a last window too short to determine
    anything (under half the length) is joined to the one before it.
    """
    first = 0 if mask is None else int(np.argmax(mask))
    starts = list(range(first, samples, length))
    if len(starts) > 1 and samples - starts[-1] < length / 2:
        starts.pop()
    stops = [*starts[1:], samples]
    keep = [
        (a, b - a) for a, b in zip(starts, stops, strict=True) if mask is None or mask[a:b].any()
    ]
    begin, size = (np.array(v, dtype=np.int64) for v in zip(*keep, strict=True))
    return WindowLayout(begin, size, mask)


def halves(samples: int, block: int) -> tuple[Array, Array]:
    """Masks of the even blocks (they select) and the odd blocks (they judge and estimate).

    With white measurement noise the two halves are independent data, whatever the windows.
    """
    odd = (np.arange(samples) // block) % 2 == 1
    return ~odd, odd


def block_length(samples: int) -> int:
    """Samples in a block: 256, or less (down to 32) where the record would give under 16 blocks."""
    return int(min(256, max(32, 2 ** int(np.log2(max(samples // 16, 32))))))


def fair_block(values: Array, block: int) -> int:
    """The longest block (``block`` or halved, at least 8) that gives both halves the same motion.

    Of every quarter of each channel's range of values (by rank; ``values`` is (samples, channels))
    either half must hold its share, 50 +- 5 % (two standard errors of a fair draw where that is
    more). Where a slow record has few episodes, long blocks would let one half see what the other
    never meets, and nothing could be judged.
    """
    quarters = [np.array_split(np.argsort(c, kind="stable"), 4) for c in values.T]
    while block > _SHORTEST:
        even, _ = halves(len(values), block)
        shares = [(even[q].mean(), max(_FAIR, 1.0 / np.sqrt(len(q)))) for c in quarters for q in c]
        if all(abs(share - 0.5) <= allowed for share, allowed in shares):
            break
        block //= 2
    return block


def stage_lengths(samples: int, mask_block: int) -> list[int]:
    """Window lengths 64, 256, 1024, whole record, as far as the record goes."""
    lengths = [n for n in (min(64, mask_block), 256, 1024) if n <= mask_block or 4 * n <= samples]
    return [*dict.fromkeys(lengths), samples]
