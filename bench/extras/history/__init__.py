"""Many runs of one or several benches: ledgers merged, one table, control charts, drift. Writes no run folder."""
