"""Many runs of one or several benches: ledgers merged, one table. Writes no run folder."""
