"""What a record can tell: before any fit, and of the model's own parameters.

``identify``: the verb, by the paper's theory on ``signatures`` and their ``richness``.
``parameters``: the model's own, told apart or not. ``information``: what a planned test would tell.
"""
