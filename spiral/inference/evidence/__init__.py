"""Evidence from trajectories, and its judgement on samples that did not select.

``assembly``: one compiled study of the model and all candidates. ``standing``: fits on growing
windows. ``scoring``: scores of every candidate; ``gridnull``, ``farstart`` and ``inseparable`` the
price of a grid of shapes, candidates that zero amplitude hides, and what the model can take over.
``admission``: a candidate admitted and refitted. ``judge``: held-out samples.
"""
