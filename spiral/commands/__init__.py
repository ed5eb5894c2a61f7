"""What each verb of the command line does: a request in, an outcome out, nothing printed."""
