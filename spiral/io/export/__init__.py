"""A model as text or a program: equations, source in other languages, an FMU (``kinds``)."""
