"""numpy to proto and back: pure functions, shared by both clients, one file a noun.

Each file ends with the calls of its noun as values: request and reader together.
"""
