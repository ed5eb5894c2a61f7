"""Effects as formulas: read by an allow-list, units inferred and checked, made into classes."""
