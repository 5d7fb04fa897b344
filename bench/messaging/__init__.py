"""Messages about runs to people, and an outbox that keeps them while the network is down."""
