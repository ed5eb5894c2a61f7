"""Fits and scores by the likelihood of one-step predictions, with a model of the noise.

``engine.likelihood`` has the numbers (filter, slopes, maximum), this package fits a study's state
(``starts``, ``fitting``, ``ladder``: what is random) and scores and races candidates (``scores``,
``candidates``, ``judging``), ``inference.strategies.likelihood`` makes a round of them, and the
plugin ``strategies.likelihood`` holds the options.
"""
