"""Models judged by the likelihood of one-step predictions, with a model of what is random."""
