"""The page on 127.0.0.1: a study driven by hand, one effect at a time.

``study`` what is kept on disk; ``bench`` the steps of a study in memory (they are the loop's own);
``scribe`` what follows a step (maps, saved run, MLflow); ``crew`` the processes in which both run;
``desk`` what the page knows and may ask; ``guard`` who may ask; ``upload`` files; ``serve`` the
server; ``page``, ``start`` and ``panels`` what is seen. Only the last five know the web.
"""
