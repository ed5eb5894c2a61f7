"""Shipped plugins: systems."""
