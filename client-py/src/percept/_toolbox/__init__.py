"""The toolbox's calls, one file a group, each for the blocking and for the asyncio client."""
