"""Physics written once: traced to expressions, their Jacobians, units and compiled code."""
