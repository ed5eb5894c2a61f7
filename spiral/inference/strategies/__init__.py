"""Kinds of evidence, ``strategy=shooting``, ``paper`` or ``innovation``: one module for each.

``base``: what each supplies to the loop. ``retire``: the backward step. ``resolved``: effects with
states of their own, from the spectrum of what a fit leaves.
"""
