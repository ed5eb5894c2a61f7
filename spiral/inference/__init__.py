"""The steps of a study: compare, diagnose, discover, estimate, identify, plan."""
