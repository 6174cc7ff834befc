"""What docs/site is made of; docs/site runs it."""
