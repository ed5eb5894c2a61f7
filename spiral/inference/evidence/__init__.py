"""Evidence from trajectories, and its judgement on samples that did not select.

``assembly``: a problem with its compiled model and all candidates. ``fit_state``: where a study
stands, and fits on growing windows. ``comparison``: a fitted model against fit and test records.
``scoring``: scores of every candidate; ``gridnull``, ``farstart`` and ``inseparable`` the price of
a grid of shapes, candidates that zero amplitude hides, and what the model can take over.
``admission``: a candidate admitted and refitted. ``judge``: held-out samples. ``horizons``: errors
so far ahead. ``scales``: how far ports move; ``spectrum`` and ``lines``: at which frequencies.
"""
