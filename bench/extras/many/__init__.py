"""Much work on many processors: a map of pure functions over items, and the recalculation of many runs with it."""
