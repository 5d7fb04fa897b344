"""What can go wrong, by name, and how it is brought about."""
