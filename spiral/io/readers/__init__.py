"""From files to records: dialects, formats, columns, gaps and rates, pulses, a rotor's options.

``files`` and ``readers`` give tables; ``columns`` says which column is what; ``pulses``,
``sampling`` and ``preparation`` change numbers, each only where that is asked for.
"""
