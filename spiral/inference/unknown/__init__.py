"""What is missing and in no catalog: a curve over the state that the missing force follows.

``shape``: which state. ``forcecurve``: the curve and its band. ``curvepath``: what a record visits
of it. ``memory``: the curve with what the force remembers. ``holding``: a study that goes on with
further effects, its state carried from one compilation to the next (used by every strategy).
"""
