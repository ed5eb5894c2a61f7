"""Sweeps: ``jobs`` to run, a ``pool`` of processes for them, a ``ledger`` of their results."""
