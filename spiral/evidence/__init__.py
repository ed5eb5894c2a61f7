"""Evidence from trajectories, and its judgement on samples that did not select.

``assembly``: one compiled study of the model and all candidates. ``trajectories``: fits on growing
windows, scores of every candidate. ``farstart``, ``gridnull``: candidates that zero amplitude
hides, and the price of a grid of shapes. ``inseparable``: what the model can take over. ``judge``:
held-out samples.
"""
