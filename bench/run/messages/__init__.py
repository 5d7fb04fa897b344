"""Messages about runs to people who are away: kept in an outbox, and delivered by mail or by apprise."""
