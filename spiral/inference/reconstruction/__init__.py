"""Hidden states from channels: calibrated on whole records, filtered, and judged."""
