"""The rounds of ``strategy=shooting``, on windows; scores and fits: ``spiral.inference.evidence``.

``propose``: a round: candidates scored on one half of the blocks, tested on the other.
``resonances``: effects with states of their own, from the spectrum of what a fit leaves.
``retire``: the backward step, which drops effects that a later one makes superfluous.
"""
