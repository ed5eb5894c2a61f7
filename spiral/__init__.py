"""spiral: find the physics that a model is missing."""

__version__ = "0.1.0"
