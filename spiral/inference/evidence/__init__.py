"""Evidence for candidates from fitted trajectories, tested on samples that took no part in it.

``assembly``: a problem with its compiled model and all candidates. ``fit_state``: active effects
and values, and fits on growing windows. ``comparison``: a fitted model against fit and test
records. ``scoring``: scores of every candidate; ``effective_tests``: how many independent
tests a grid of shapes amounts to; ``refit_scores``: candidates that a linear step from zero
amplitude does not show; ``inseparable``: candidates that the model's own parameters imitate.
``admission``: a candidate admitted and refitted. ``enlarge``: a study compiled with
further effects. ``judge``: fits and free runs on held-out samples.
``horizons``: prediction errors at several horizons. ``scales``: largest motion at every port;
``spectrum`` and ``spectral_lines``: trial frequencies.
"""
