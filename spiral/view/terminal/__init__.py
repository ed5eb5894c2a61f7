"""Terminal output: one module for each family of verbs, built from ``parts``."""
