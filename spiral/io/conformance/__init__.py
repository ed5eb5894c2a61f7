"""What ``spiral check`` looks at, kind by kind: what was seen, or an error with what is wrong."""
