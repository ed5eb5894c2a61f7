"""What a person sees in a terminal: one module for each family of verbs, built from ``parts``."""
