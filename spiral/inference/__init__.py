"""From a question to an answer: compare, diagnose, discover, estimate, identify, plan."""
