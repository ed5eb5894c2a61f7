"""Numerics of ``strategy=likelihood``: one-step predictions, their likelihood, its maximum."""
