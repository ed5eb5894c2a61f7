"""Filtering: hidden states and their uncertainty from a known model and measured channels."""
