"""Robots: trees of rigid bodies on hinges and slides, and their equations of motion."""
