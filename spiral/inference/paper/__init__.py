"""Parts of ``strategy=paper``: the paper's regression, learner's projection, tests and log."""
