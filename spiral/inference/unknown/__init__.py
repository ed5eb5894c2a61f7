"""What is missing and in no catalog: a curve over the state that the missing force follows.

``shape``: which state. ``forcecurve``: the curve and its band. ``curvepath``: what a record visits
of it. ``holding``: studies that go on with a curve, or with an effect that has own states.
"""
