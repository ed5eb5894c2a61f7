"""Shipped plugins: learners."""
