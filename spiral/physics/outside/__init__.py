"""Models that are programs (an FMU, a Python function) inside the expressions of a system."""
