"""Kinds of evidence: ``strategy=likelihood`` (default), ``shooting``, ``innovation``, ``paper``.

``base``: what each supplies to the loop; beside it a module of its name for each. Steps of
``likelihood``: ``beginning`` (the model as it is), ``admission`` (whether a candidate holds, and
the model with it), ``look_alikes``, ``superfluous`` (what a model no longer wants),
``other_noise``, ``memory_rounds`` (memory), ``laws`` and ``curves``. Of ``shooting``: ``retire``
(the backward step) and ``resonances`` (effects with states of their own, from the spectrum of what
a fit leaves).
"""
