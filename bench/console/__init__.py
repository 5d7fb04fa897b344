"""How commands speak with a person: tables, progress, questions, signals."""
