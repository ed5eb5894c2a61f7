"""Output for people: terminal text, report and figures; pure functions of results."""
