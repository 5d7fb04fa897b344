"""Many runs, one after another, each in a watched process."""
