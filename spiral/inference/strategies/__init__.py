"""Kinds of evidence: ``strategy=likelihood`` (default), ``shooting``, ``innovation``, ``paper``.

``base``: the interface of a strategy; each strategy has a module of its own name. Steps of
``likelihood``: ``beginning`` (the model as it is), ``admission`` (whether a candidate holds, and
the model with it), ``look_alikes`` (candidates that the record did not distinguish),
``superfluous`` (admitted effects that are dropped), ``other_noise``, ``memory_rounds`` (forces with
memory), ``laws`` and ``curves``. Of ``shooting``: ``retire`` (the backward step) and ``resonances``
(effects with states of their own, from the spectrum of the residual).
"""
