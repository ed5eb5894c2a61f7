"""The page on 127.0.0.1: a study driven by hand, one effect at a time.

``study`` is what is kept on disk; ``session`` what the page knows and may ask, one for all tabs.
Two ``processes`` work beside it: ``fit_worker`` goes through the steps of a study in memory (they
are the loop's own), ``run_writer`` does what follows a step (maps, saved run, MLflow). ``guard``
says who may ask, ``upload`` and ``file_setup`` take files, ``serve`` is the server; ``page``,
``start``, ``mapping`` and ``panels`` are what is seen. Only the last six know the web.
"""
