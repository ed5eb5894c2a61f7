"""What a person sees: the terminal and the report; pure functions of results."""
