"""Sweeps: ``jobs`` asked, a ``pool`` that runs them, a ``ledger`` of those that ended."""
