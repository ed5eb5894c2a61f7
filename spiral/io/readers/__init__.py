"""From files to records: dialects, formats, columns, gaps and rates, pulses, a rotor's options.

``formats`` reads files into tables (``table``); ``columns`` says which column is what; ``pulses``,
``sampling`` and ``rotor_series`` change numbers, each only where that is asked for.
"""
