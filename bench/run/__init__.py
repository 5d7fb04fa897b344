"""One run: its states, what is done in each, how it is begun, held, stopped and taken up again."""
