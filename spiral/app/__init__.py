"""The page (web application on 127.0.0.1): a study in which the user adds one effect at a time.

``study`` is the data kept on disk; ``session`` holds all open studies and sends orders, one for
all tabs of the browser. Two ``processes`` work beside it: ``fit_worker`` fits and ranks a study in
memory, with the steps of ``spiral.inference.rounds``; ``run_writer`` does what follows a step
(maps, saved run, MLflow). ``guard`` refuses requests without the token, ``upload`` and
``file_setup`` take files, ``serve`` is the server. ``start``, ``mapping`` and ``page`` build the
three pages, ``panels`` and ``horizon_errors`` their HTML text.
"""
