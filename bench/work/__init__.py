"""Much work in pieces: who does it, what is kept of it, and the recalculation and the verification of many folders."""
