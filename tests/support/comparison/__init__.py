"""What `compare_checkouts.py` is made of: two sides, scenarios, rules for what varies, and the comparison."""
