"""Coroutines run to their end on a loop of their own.

A browser test before them in the same process leaves a running loop in its thread.
"""

import asyncio
from concurrent.futures import ThreadPoolExecutor


def on_a_loop(coroutine):
    """What a coroutine returns."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, coroutine).result()
