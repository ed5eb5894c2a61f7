"""Missing forces that are in no catalog: learned as a curve over the state that they follow.

``shape``: which state. ``forcecurve``: the curve and its band. ``curvepath``: what a record visits
of it. ``memory``: a missing force that depends on the past of the motion.
"""
