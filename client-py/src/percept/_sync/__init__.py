# Written by client-py/generate from _async/__init__.py; change that.
"""The client, written once: for asyncio. `client-py/generate` writes the same for threads, `_sync`."""
