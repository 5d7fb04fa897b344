"""Plans and jobs: a sequence and a station, checked against each other, with times, sizes and limits."""
