"""Shipped plugins: sources."""
