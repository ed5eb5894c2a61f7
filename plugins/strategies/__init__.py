"""Kinds of evidence: the whole record's likelihood, windows, a filter's innovations, the paper's.

Their steps are in ``spiral.inference.strategies``, imported when a study begins.
"""
