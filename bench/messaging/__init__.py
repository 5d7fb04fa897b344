"""Who is told of what, and an outbox that survives a dead network."""
