"""What a sequence would do on a station, told before anything moves."""
