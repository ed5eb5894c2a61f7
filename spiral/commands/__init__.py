"""The verbs of the command line, as functions from a request to an outcome; they print nothing."""
