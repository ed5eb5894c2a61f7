"""Parameters and noise by the likelihood of one-step predictions over whole records."""
