"""What is missing and in no catalog: a curve over the state that the missing force follows.

``shape``: which state. ``forcecurve``: the curve and its band. ``curvepath``: what a record visits
of it. ``memory``: a missing force that depends on the past of the motion.
"""
