"""The compiled study, and fits, scores and free runs that all strategies share.

Scores on windows are for ``strategy=shooting``.

``assembly``: the problem with its compiled model.
``fit_state``: active effects and their values, and fits on growing windows.
``comparison``: a model fitted on windows against fit and test records.
``free_run``: the model integrated over a record, only its initial state and phase fitted.
``horizons``: prediction errors at several horizons.
``scoring``: scores of all candidates on windows.
``effective_tests``: how many independent tests a grid of shapes amounts to.
``refit_scores``: candidates that a linear step from zero amplitude does not show.
``inseparable``: candidates that the model's own parameters can imitate.
``admission``: a candidate admitted to the model, which is refitted on windows.
``enlarge``: a study compiled with further effects.
``scales``: the largest motion at every port.
``spectrum``, ``spectral_lines``: trial frequencies of effects with states of their own.
"""
