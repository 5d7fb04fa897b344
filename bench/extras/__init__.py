"""What the core knows nothing of: each room here is opened by its commands only."""
