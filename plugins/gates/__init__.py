"""Shipped plugins: gates."""
