"""The shooting engine: windows, sensitivities, fit and score."""
