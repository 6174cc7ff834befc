"""The contract, generated from proto/percept/v1 by ./generate. Public signatures do not show it."""
