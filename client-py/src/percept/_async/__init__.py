"""The client, written once: for asyncio. `client-py/generate` writes the same for threads, `_sync`."""
